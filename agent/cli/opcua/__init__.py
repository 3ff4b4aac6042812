"""`deltak opcua`: parameters and alarms as an OPC UA server, a separate process that only reads databases."""
