"""What a hand is made of: excited, fitted, judged."""
