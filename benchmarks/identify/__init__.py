"""Which materials can be found from a clip: how well, from how far, in what time, and what cannot be."""
