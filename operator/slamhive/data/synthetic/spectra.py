# SPDX-License-Identifier: Apache-2.0
"""Spectra of what carries a platform: by coordinate, frequencies (Hz) and their share of the amplitude.

They are chosen after what carriers are like, not measured on one: a walker steps about twice a second, sways
at half of that, and has hands that tremble at 8 to 10 Hz; a car heaves, pitches and rolls on its springs at 1
to 2 Hz, its wheels hop at 10 to 12 Hz, and an idle engine of four cylinders shakes at 25 Hz.
"""

from __future__ import annotations

from slamhive.model.synthetic import SyntheticSpectrum

SPECTRA = {
    SyntheticSpectrum.WALKER: (
        ((1.9, 0.4), (3.8, 0.2), (5.7, 0.05), (7.6, 0.03)),
        ((0.95, 0.8), (1.9, 0.2), (2.85, 0.15), (5.7, 0.05)),
        ((1.9, 1.0), (3.8, 0.25), (5.7, 0.08), (7.6, 0.04)),
        ((0.95, 0.8), (2.85, 0.3), (6.4, 0.1), (9.1, 0.08)),
        ((1.9, 1.0), (3.8, 0.4), (5.7, 0.1), (8.7, 0.1)),
        ((0.95, 0.8), (2.85, 0.3), (4.75, 0.1), (9.4, 0.08)),
    ),
    SyntheticSpectrum.VEHICLE: (
        ((1.6, 0.3), (11.0, 0.03), (12.5, 0.02), (25.0, 0.003)),
        ((0.8, 0.3), (1.4, 0.4), (10.5, 0.03), (25.0, 0.003)),
        ((1.3, 1.0), (1.7, 0.4), (11.5, 0.06), (25.0, 0.004)),
        ((0.8, 0.5), (1.4, 1.0), (10.5, 0.05), (25.0, 0.003)),
        ((1.2, 0.4), (1.6, 1.0), (11.5, 0.05), (25.0, 0.003)),
        ((0.6, 0.6), (1.1, 0.3), (10.5, 0.02), (25.0, 0.002)),
    ),
}
"""Of x, y, z, then roll, pitch and yaw; shares of amplitudeMetres, then of amplitudeDegrees."""
