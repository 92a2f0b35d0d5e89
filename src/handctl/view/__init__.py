"""Display of logs and of running hands in the viewer Rerun. No other package imports Rerun."""
