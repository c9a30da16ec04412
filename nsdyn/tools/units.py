"""Numbers with units, in the format of the HTML page."""

from __future__ import annotations

PREFIXES = {1e9: "G", 1e6: "M", 1e3: "k", 1.0: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n"}


def with_unit(value: float, unit: str) -> str:
    """Return a number of four digits with its unit and the appropriate prefix; units of angles get no prefix.

    >>> with_unit(10820.0, "J"), with_unit(98.1, "J"), with_unit(0.0, "J"), with_unit(2e-3, "rad/s")
    ('10.82 kJ', '98.1 J', '0 J', '0.002 rad/s')
    """
    if unit.startswith("rad"):
        return f"{value:.4g} {unit}"
    # A number that rounds to 1000 gets the next prefix.
    factor = next((factor for factor in PREFIXES if abs(value) >= 0.99995 * factor), 1.0)
    return f"{value / factor:.4g} {PREFIXES[factor]}{unit}"
