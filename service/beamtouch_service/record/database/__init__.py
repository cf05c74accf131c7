"""The tables of the record, and connections to the database that holds them: SQLite or PostgreSQL."""
