"""Display of logs and running hands in Rerun. Only this package imports Rerun."""
