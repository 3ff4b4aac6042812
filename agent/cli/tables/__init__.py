"""What runs found and what database files hold, as tables, CSV and JSON."""
