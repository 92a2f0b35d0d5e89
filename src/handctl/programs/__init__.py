"""Programs of the controller. A program sets the goals of all digits in every tick."""
