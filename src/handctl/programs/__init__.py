"""Programs decide the goals of all digits, tick after tick."""
