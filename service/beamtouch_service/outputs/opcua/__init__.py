"""The OPC UA server: surfaces as objects, contacts as variables with their age, events as OPC UA events. Read only."""
