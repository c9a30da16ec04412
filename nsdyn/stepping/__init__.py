"""The step: moves between impacts, the contact law, impacts, projection, and where the energy went."""
