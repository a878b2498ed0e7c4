"""OpenCV beside this project's detectors. Needs opencv-python-headless (and numpy, which it brings).

opencv_boards.py find COLSxROWS FILE...: corners by both chessboard detectors, refined, as JSON.
opencv_boards.py time COLSxROWS FILE LARGE: writes LARGE, six times the size, and gives the seconds of
the faster detector that finds the board there.
opencv_boards.py draw FOLDER: boards drawn by OpenCV and seen obliquely, with the truth.
"""
import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np

SETTLED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)


def refined(image, corners, size):
    points = corners.reshape(-1, 1, 2).astype(np.float32)
    flat = points.reshape(-1, 2)
    spacing = min(np.linalg.norm(flat[0] - flat[1]), np.linalg.norm(flat[0] - flat[size[0]]))
    half = int(np.clip(spacing / 4, 2, 5 * max(1, image.shape[1] / 640)))
    out = cv2.cornerSubPix(image, points, (half, half), (-1, -1), SETTLED)
    return out.reshape(-1, 2).tolist()


def detectors(image, size):
    yield "classic", lambda: cv2.findChessboardCorners(image, size)
    yield "sector", lambda: cv2.findChessboardCornersSB(image, size)


def find(size, files):
    answer = {}
    for file in files:
        image = cv2.imread(file, cv2.IMREAD_GRAYSCALE)
        found = {}
        for name, detect in detectors(image, size):
            there, corners = detect()
            found[name] = refined(image, corners, size) if there else None
        answer[file] = found
    return answer


def fastest(size, file, large):
    cv2.setNumThreads(1)
    image = cv2.imread(file, cv2.IMREAD_GRAYSCALE)
    image = cv2.resize(image, None, fx=6, fy=6, interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(large, image)
    best = None
    for _, detect in detectors(image, size):
        for _ in range(3):
            start = time.perf_counter()
            there, _ = detect()
            took = time.perf_counter() - start
            if there and (best is None or took < best):
                best = took
    return best


def seen(picture, points, corners, shape, rng):
    """A picture of a board whose outer corners lie at `corners` of the image, and its points."""
    fine = 3
    h, w = picture.shape
    outer = np.float32([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    to = cv2.getPerspectiveTransform(outer, np.float32(corners))
    grow = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1]])
    large = cv2.warpPerspective(
        picture, grow @ to, (shape[0] * fine, shape[1] * fine), borderValue=120
    )
    image = cv2.resize(large, shape, interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.7).astype(float) * 0.75 + 25
    image = np.clip(image + rng.normal(0, 2.0, image.shape), 0, 255).astype(np.uint8)
    placed = cv2.perspectiveTransform(np.float64(points).reshape(-1, 1, 2), to).reshape(-1, 2)
    return image, placed


# Where the board's outer corners lie in images of 800 x 600: whole, turned, and partly outside.
VIEWS = {
    "whole": [[90, 70], [690, 40], [730, 540], [60, 500]],
    "turned": [[700, 90], [640, 560], [90, 500], [170, 60]],
    "partial": [[-260, -60], [600, 30], [720, 620], [-160, 480]],
}


def draw(folder):
    folder = Path(folder)
    rng = np.random.default_rng(7)
    boards = []
    for name, size, legacy in [
        ("DICT_4X4_50", (7, 5), False),
        ("DICT_5X5_100", (9, 6), False),
        ("DICT_6X6_250", (8, 8), False),
        ("DICT_4X4_50", (7, 6), True),
    ]:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        board = cv2.aruco.CharucoBoard(size, 0.04, 0.03, dictionary)
        board.setLegacyPattern(legacy)
        square = 120
        picture = board.generateImage((size[0] * square, size[1] * square))
        corners = [
            [c * square - 0.5, r * square - 0.5]
            for r in range(1, size[1])
            for c in range(1, size[0])
        ]
        for view, outer in VIEWS.items():
            image, truth = seen(picture, corners, outer, (800, 600), rng)
            file = folder / f"{name}_{size[0]}x{size[1]}_{view}.png"
            cv2.imwrite(str(file), image)
            found, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
            opencv = [None] * len(corners)
            for k, id in enumerate([] if ids is None else ids.ravel()):
                opencv[int(id)] = found.reshape(-1, 2)[k].tolist()
            boards.append(
                dict(
                    file=str(file),
                    board=f"charuco:{size[0]}x{size[1]}:{name}",
                    partial=view == "partial",
                    truth=truth.tolist(),
                    opencv=opencv,
                )
            )
    cols, rows, step = 4, 11, 60
    centres = [[(2 * c + r % 2) * step + 80, r * step + 80] for r in range(rows) for c in range(cols)]
    picture = np.full((rows * step + 100, 2 * cols * step + 100), 255, np.uint8)
    for x, y in centres:
        cv2.circle(picture, (x * 16, y * 16), 20 * 16, 0, -1, cv2.LINE_AA, 4)
    for view in ("whole", "turned"):
        image, truth = seen(picture, centres, VIEWS[view], (800, 600), rng)
        file = folder / f"circles_{view}.png"
        cv2.imwrite(str(file), image)
        there, found = cv2.findCirclesGrid(
            image, (cols, rows), flags=cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
        )
        boards.append(
            dict(
                file=str(file),
                board=f"circles:{cols}x{rows}",
                partial=False,
                truth=truth.tolist(),
                opencv=found.reshape(-1, 2).tolist() if there else [None] * len(centres),
            )
        )
    return boards


if __name__ == "__main__":
    command, rest = sys.argv[1], sys.argv[2:]
    if command == "draw":
        answer = draw(rest[0])
    else:
        size = tuple(int(n) for n in rest[0].split("x"))
        answer = find(size, rest[1:]) if command == "find" else fastest(size, rest[1], rest[2])
    json.dump(answer, sys.stdout)
