"""The scene in which a hand grasps: an object, its support, and the events after the grasp."""
