"""Records as rows, one file a table. No transaction is opened here."""
