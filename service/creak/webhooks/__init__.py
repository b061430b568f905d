"""Webhooks: messages from the store's outbox to receivers, signed, in order, at least once, nowhere else."""
