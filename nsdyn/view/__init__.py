"""Views of a recording: page, pictures, plots."""
