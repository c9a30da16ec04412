"""The step: moves between impacts, the contact law, impacts, position projection, and the energy ledger."""
