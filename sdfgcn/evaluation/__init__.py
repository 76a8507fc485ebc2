"""From a trained or written agent to a row: episodes, intervals, and the paper's figures beside."""
