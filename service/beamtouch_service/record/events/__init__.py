"""Samples to events, their best samples and health, with the cursor of each boot. Pure but for the run of the model."""
