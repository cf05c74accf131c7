"""The record: events from every sample, once and in order, stored with the cursor of each boot."""
