"""What a simulation leaves: the recording, its file, its page, and the audit of it."""
