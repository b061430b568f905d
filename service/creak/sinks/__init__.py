"""Where records go: the store that the API reads, and the recording."""
