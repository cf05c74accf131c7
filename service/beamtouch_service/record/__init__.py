"""The record: events from every sample, once and in order, stored with the cursor of each boot.

recorder   the record of a service: what it takes in, and when that becomes durable
events/    samples to events, best samples and health: pure
writing/   the one writer: a thread with a connection of its own; what is deleted
reading/   two readers, each a thread with a connection of its own; queries
database/  tables, and connections to SQLite or PostgreSQL
"""
