"""Units as plain factors: the library computes in mm, s and mJ (and mW, mW/mm², mJ/mm³), for numbers near one.

``67 * um`` is a length in mm; ``x / um`` reads one back in micrometres. Irradiance and dose are written in the usual
units, ``65 * mW_cm2`` and ``100 * mJ_cm3``; 1 mW/mm² is 100 mW/cm² and 1 mJ/mm³ is 1000 mJ/cm³.
"""

from __future__ import annotations

from math import pi

mm: float = 1.0
um: float = 1e-3
nm: float = 1e-6
cm: float = 10.0
m: float = 1e3
s: float = 1.0
ms: float = 1e-3
us: float = 1e-6
Hz: float = 1.0
minute: float = 60.0
hour: float = 3600.0
day: float = 86400.0
mJ: float = 1.0
J = 1e3
mW: float = 1.0
W = 1e3
rad: float = 1.0
deg: float = pi / 180.0
mW_cm2: float = mW / cm**2
mW_mm2: float = mW / mm**2
W_cm2: float = W / cm**2
mJ_cm3: float = mJ / cm**3
mJ_mm3: float = mJ / mm**3
J_cm3: float = J / cm**3
mJ_cm2: float = mJ / cm**2
rpm: float = 2.0 * pi / minute
dpt: float = 1.0 / m
kg_m3: float = 1e3 * mJ * s**2 / m**2 / m**3
Pa_s: float = J * s / m**3
mol: float = 1.0
mol_m3: float = 1.0  # concentrations are kept in mol/m³, which is mM
g_mol: float = 1.0
K = 1.0

NAMES = {
    "mm": mm, "um": um, "µm": um, "cm": cm, "m": m, "nm": nm,
    "s": s, "ms": ms, "us": us, "µs": us, "min": minute, "h": hour, "d": day, "Hz": Hz, "kHz": 1e3 * Hz,
    "mJ": mJ, "J": J, "mW": mW, "W": W,
    "rad": rad, "deg": deg, "°": deg,
    "mW/cm2": mW_cm2, "mW/cm²": mW_cm2, "mJ/cm3": mJ_cm3, "mJ/cm³": mJ_cm3, "mJ/cm2": mJ_cm2, "mJ/cm²": mJ_cm2,
    "mW/mm2": mW_mm2, "mW/mm²": mW_mm2, "mJ/mm3": mJ_mm3, "mJ/mm³": mJ_mm3,
    "W/cm2": W_cm2, "W/cm²": W_cm2, "J/cm3": J_cm3, "J/cm³": J_cm3,
    "1/mm": 1.0 / mm, "/mm": 1.0 / mm, "1/cm": 1.0 / cm, "/cm": 1.0 / cm,
    "rpm": rpm, "deg/s": deg / s, "°/s": deg / s, "rad/s": rad / s,
    "mm/s": mm / s, "mm/min": mm / minute, "mm/h": mm / hour, "m/min": m / minute,
    "dpt": dpt, "MB/s": 1e6 / s, "GB/s": 1e9 / s,
    "kg/m3": kg_m3, "kg/m³": kg_m3, "g/cm3": 1e3 * kg_m3, "g/cm³": 1e3 * kg_m3, "g/mL": 1e3 * kg_m3,
    "Pa s": Pa_s, "mPa s": 1e-3 * Pa_s, "cP": 1e-3 * Pa_s,
    "mm2/s": mm**2 / s, "mm²/s": mm**2 / s, "cm2/s": cm**2 / s, "cm²/s": cm**2 / s, "m2/s": m**2 / s, "m²/s": m**2 / s,
    "mol/m3": mol_m3, "mol/m³": mol_m3, "mM": mol_m3, "mol/L": 1e3 * mol_m3, "g/mol": g_mol, "K": K,
    "wt%": 1e-2, "ppm": 1e-6, "%": 1e-2,
}  # fmt: skip
"""Spelling used in job files → factor; `vamgpu.quantity.parse` reads further spellings of the same units."""
