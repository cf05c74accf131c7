"""The report of a build: one HTML page that needs nothing but itself.

`facts` measures what the metadata does not have; `page` makes the charts and fills `page.html`, with the
pictures of `beam_drawing` and `plate_pictures`.
"""
