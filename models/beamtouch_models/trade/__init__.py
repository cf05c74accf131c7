"""The trade between speed, sensors, filter and accuracy."""
