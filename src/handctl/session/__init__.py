"""A run of a hand, from checked files to its log and its verdict: what every verb and every study has in common."""
