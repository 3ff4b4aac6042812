"""Records as rows, and rows read back as records. No transaction is opened here."""
