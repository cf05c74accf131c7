"""The record: events from every sample, once and in order, stored with the cursor of each boot.

recorder -> record -> boot -> event, load, best, health     what samples become, in memory
recorder -> writer -> store -> tables, database             one thread makes it durable
api, outputs -> readers -> queries -> tables, database      two threads read what is durable
recorder -> retention -> ageing                             what is deleted
"""
