"""The source paper reproduced: every equation, number and figure, with what is wrong in it."""
