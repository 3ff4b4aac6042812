"""PostgreSQL by psycopg: a table a topic, each row once by rig and seq; hypertables with TimescaleDB."""
