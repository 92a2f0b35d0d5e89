"""What a tick shows to safety, and how much tension may be commanded then."""
