"""What is no mechanics: names that users give, files that are written, processes, and the noise of libraries."""
