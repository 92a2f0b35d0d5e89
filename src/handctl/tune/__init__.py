"""From a hand with unknown friction and doubtful gains to gains with evidence: identify, design, search, verify."""
