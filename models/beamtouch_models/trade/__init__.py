"""What speed, sensors and samples buy in accuracy, measured on this machine."""
