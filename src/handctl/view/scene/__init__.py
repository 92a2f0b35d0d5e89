"""What the dashboard shows, and how a run's topics become it."""
