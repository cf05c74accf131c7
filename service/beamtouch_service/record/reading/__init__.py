"""The readers of the record: two threads that read what is durable, and write nothing."""
