"""The pure controller: ``tick``, modes, state, requests, retuning and shutdown."""
