"""The trade between speed, sensors, noise and accuracy.

`measure` makes and measures models, in each of which one thing (`Varied`) differs from the model that `build` makes.
`trade` has all of them and their front, `results` their sentences, tables and charts.
"""
