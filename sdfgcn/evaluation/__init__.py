"""Evaluation of agents: episodes, results with intervals, and the paper's figures."""
