"""Recordings of simulations: states, energies, contacts and certificates, their files and tables."""
