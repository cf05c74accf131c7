"""The one writer of the record: every call is a transaction, one after the other, in a thread of its own."""
