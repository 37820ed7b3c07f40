"""Arms by the lengths of their data sheets: frames of the links, and configuration data."""

import numpy as np

Array = np.ndarray
RODS = "ABB IRB 2400"
# Heights and lengths of data sheets, mm: axis 2 (x, z), upper arm, offset of the forearm, forearm,
# flange; then whether the controller's base is at the height of axis 2.
SHEETS = {
    "ABB IRB 120": (0, 290, 270, 70, 302, 72, False),
    "ABB IRB 1600-6/1.2": (150, 486.5, 475, 0, 600, 65, False),
    "ABB IRB 4600-60/2.05": (175, 495, 900, 175, 960, 135, False),
    RODS: (100, 615, 705, 135, 755, 85, False),
    "KUKA KR 16-2": (260, 675, 680, -35, 670, 158, False),
    "KUKA KR 6 R900 sixx": (25, 400, 455, 35, 420, 80, False),
    "Fanuc LR Mate 200iD": (50, 330, 330, 35, 335, 80, True),
    "Fanuc M-20iA": (150, 525, 790, 250, 835, 100, True),
}


def about(axis: str, degrees: float) -> Array:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.eye(4)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    turn[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return turn


def along(x: float, z: float) -> Array:
    move = np.eye(4)
    move[:3, 3] = 1e-3 * x, 0.0, 1e-3 * z
    return move


def links(name: str, theta: Array) -> list[Array]:
    """Frames of shoulder, elbow, wrist and flange in the controller's base; θ without coupling."""
    x, z, upper, offset, fore, flange, raised = SHEETS[name]
    maker, kuka = name.split(maxsplit=1)[0], name.startswith("KUKA")
    a = (
        theta
        * {
            "ABB": np.array([1, 1, 1, 1, 1, 1]),
            "KUKA": np.array([-1, 1, 1, -1, 1, -1]),
            "Fanuc": np.array([1, 1, -1, -1, -1, -1]),
        }[maker]
    )
    # KUKA's zero has the upper arm along x.
    arm = along(upper, 0) if kuka else along(0, upper)
    shoulder = about("z", a[0]) @ along(x, 0 if raised else z)
    elbow = shoulder @ about("y", a[1]) @ arm
    wrist = elbow @ about("y", a[2]) @ along(fore, offset) @ about("x", a[3]) @ about("y", a[4])
    end = wrist @ about("x", a[5]) @ along(flange, 0)
    turn = about("y", -90.0) @ about("x", 180.0) if maker == "Fanuc" else about("y", 90.0)
    return [shoulder, elbow, wrist, end @ turn]


def places(name: str, theta: Array) -> tuple[float, float]:
    """The wrist before the first axis, and before the lower arm, m: in the plane of the arm."""
    shoulder, elbow, wrist, _ = links(name, theta)
    back = np.linalg.inv(links(name, np.array([theta[0], 0, 0, 0, 0, 0]))[0])
    s, e, w = ((back @ each)[[0, 2], 3] for each in (shoulder, elbow, wrist))
    x = SHEETS[name][0] * 1e-3
    (ax, az), (bx, bz) = e - s, w - s
    return float(w[0] + x), float(az * bx - ax * bz) / float(np.hypot(ax, az))


def data_of(name: str, theta: Array) -> tuple[int, ...]:
    """Configuration data at θ, degrees, as the maker's language has them."""
    behind, folded, down = *(each < 0.0 for each in places(name, theta)), theta[4] < 0.0
    if name.startswith("ABB"):
        quadrants = (int(np.floor(theta[k] / 90.0)) for k in (0, 3, 5))
        return (*quadrants, 0 if name == RODS else 4 * behind + 2 * folded + int(down))
    if name.startswith("KUKA"):
        turns = sum(2**k for k in range(6) if theta[k] < 0.0)
        return behind + 2 * (not folded) + 4 * int(down), turns
    turned = (int(np.floor((angle + 180.0) / 360.0)) for angle in theta[3:])
    return (int(not down), int(folded), int(behind), *turned)
