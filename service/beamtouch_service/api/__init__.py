"""The web interface: one file per noun of the routes, and what all routes share."""
