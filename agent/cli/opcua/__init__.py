"""`deltak opcua`: parameters and alarms as an OPC UA server, a process of its own that only reads the databases."""
