"""The source paper reproduced: every equation, number and figure, with its errors."""
