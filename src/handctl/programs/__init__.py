"""Programs: they decide the goals of all digits, tick after tick."""
