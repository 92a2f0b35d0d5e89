"""The scene of a grasp: an object, its support, and the events after the grasp."""
