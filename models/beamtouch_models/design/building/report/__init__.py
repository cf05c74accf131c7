"""The report of a build: one HTML page that needs nothing but itself.

`page` measures what the metadata does not have, makes the charts and fills `page.html`. `beam_drawing` draws the beam.
"""
