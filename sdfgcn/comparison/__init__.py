"""Experiments that compare methods: methods x training seeds x conditions, to a table.

One job of the sweep is a method with one training seed: it trains the network if it is missing,
then plays every cell (a combination of evaluation conditions) that is missing. When the sweep ends,
all cells become a table, figures and a JSON of every row.
"""
