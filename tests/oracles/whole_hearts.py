"""A whole-heart label map: seven labels as in public challenges, several of them touching.

In a frame with z from the apex to the base: the left ventricle (500) in its myocardium (205), the
left atrium (420) upon it at the mitral plane, the aorta (820) out of it and along the atrium's
wall, the right ventricle (600), right atrium (550) and pulmonary artery (850) to the left of it.
"""

import numpy as np

LABELS = {"MYO": 205, "LA": 420, "LV": 500, "RA": 550, "RV": 600, "AO": 820, "PA": 850}
ENDS = {
    "AO.top": ((27.0, 0.0, 55.0), (0.0, 0.0, 1.0)),
    "LA.RPV": ((-13.0, 34.0, 30.0), (0.0, 1.0, 0.0)),
    "LA.LPV": ((-13.0, -34.0, 30.0), (0.0, 1.0, 0.0)),
}
"""Centre and normal of the planes through the free ends of the left side."""


def _inside(points, center, semi_axes):
    return (((points - center) / semi_axes) ** 2).sum(axis=1) < 1.0


def whole_heart_labels(points):
    """Return the label (n,) of points (n, 3) in mm."""
    x, y, z = points.T
    ventricle = _inside(points, (0.0, 0.0, -25.0), (27.0, 27.0, 42.0)) & (z < 0.0)
    wall = _inside(points, (0.0, 0.0, -25.0), (36.0, 36.0, 51.0)) & (z < 2.0)
    veins = (np.hypot(x + 13.0, z - 30.0) < 7.0) & (np.abs(y) < 40.0)
    atrium = (_inside(points, (-9.0, 0.0, 20.0), (24.0, 26.0, 25.0)) & (z >= 0.0)) | veins
    aorta = (np.hypot(x - 21.0 - 0.1 * z, y) < 10.0) & (z > -12.0) & (z < 62.0)
    aorta &= ~((z < 0.0) & _inside(points, (0.0, 0.0, -25.0), (27.0, 27.0, 42.0)))
    right = _inside(points, (45.0, 0.0, -25.0), (27.0, 30.0, 40.0)) & (z < 0.0)
    right_atrium = _inside(points, (52.0, 12.0, 18.0), (22.0, 22.0, 22.0)) & (z >= 0.0)
    artery = (np.hypot(x - 45.0, y + 17.0) < 9.0) & (z >= -5.0) & (z < 55.0)
    label = np.zeros(len(points), dtype=np.int16)
    for name, mask in (
        ("PA", artery),
        ("RA", right_atrium),
        ("RV", right),
        ("MYO", wall),
        ("AO", aorta),
        ("LA", atrium & ~(aorta & (z > 0.0))),
        ("LV", ventricle),
    ):
        label[mask] = LABELS[name]
    return label
