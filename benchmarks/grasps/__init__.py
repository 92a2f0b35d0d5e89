"""What the grasp benchmark is made of."""
