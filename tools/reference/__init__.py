"""Generate text blocks of the reference pages.

``python -m tools.reference`` generates these blocks from the code and writes them into docs/.
"""
