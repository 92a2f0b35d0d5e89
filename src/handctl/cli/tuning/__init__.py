"""Commands that tune gains and identify the parameters of a hand."""
