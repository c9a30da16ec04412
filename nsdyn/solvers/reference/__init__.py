"""Methods of the literature, kept to compare: each says where it fails."""
