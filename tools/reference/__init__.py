"""Generated blocks of the reference pages.

``python -m tools.reference`` writes them from the code into docs/.
"""
