"""The trail: who changed what and when, in rows that are only ever added, each with the digest of the one before.

entry      one change, and the digest that chains it to the one before: pure
pending    the changes that are yet to be put on record: pure
table      the table, and how entries are added
deletions  what the record deleted by its limits, at most once a day
"""
