"""Measures the discs that `accuracy discs-for-peers` has written, with OpenCV's and scikit-image's usual ways."""

import csv
import sys
from pathlib import Path

import cv2
import numpy as np
import scipy.optimize
import skimage
import skimage.feature
import skimage.measure
import skimage.transform

RADIUS = 65.3


def hough(method, votes):
    def measure(image):
        smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
        found = cv2.HoughCircles(smooth, method, 1, 100, param1=60, param2=votes, minRadius=55, maxRadius=75)
        return None if found is None else found[0][0][:2]

    return measure


def otsu_ellipse(image):
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    _, binary = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    outlines, _ = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return cv2.fitEllipse(max(outlines, key=len))[0]


def canny_ellipse(image):
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    outlines, _ = cv2.findContours(cv2.Canny(smooth, 30, 60), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    longest = max(outlines, key=len, default=None)
    return None if longest is None or len(longest) < 6 else cv2.fitEllipseAMS(longest)[0]


def skimage_hough(image):
    edges = skimage.feature.canny(image.astype(float), sigma=1.5)
    radii = np.arange(60, 71)
    found = skimage.transform.hough_circle_peaks(
        skimage.transform.hough_circle(edges, radii), radii, total_num_peaks=1)
    return (found[1][0], found[2][0]) if len(found[1]) else None


def half_level(image):
    level = 0.5 * (np.percentile(image, 10) + np.percentile(image, 90))
    rows_columns = max(skimage.measure.find_contours(image.astype(float), level), key=len)
    points = rows_columns[:, ::-1]
    start = [*points.mean(axis=0), RADIUS]
    return scipy.optimize.least_squares(
        lambda c: np.hypot(points[:, 0] - c[0], points[:, 1] - c[1]) - c[2], start, loss="soft_l1").x[:2]


WAYS = {
    "OpenCV HoughCircles, GRADIENT": hough(cv2.HOUGH_GRADIENT, 20),
    "OpenCV HoughCircles, GRADIENT_ALT": hough(cv2.HOUGH_GRADIENT_ALT, 0.6),
    "OpenCV Otsu, fitEllipse": otsu_ellipse,
    "OpenCV Canny, fitEllipseAMS": canny_ellipse,
    "scikit-image hough_circle": skimage_hough,
    "scikit-image find_contours, geometric circle": half_level,
}


def main(folder):
    with open(folder / "discs.csv", newline="") as file:
        discs = list(csv.DictReader(file))
    errors = {}
    for disc in discs:
        image = cv2.imread(str(folder / disc["file"]), cv2.IMREAD_GRAYSCALE)
        truth = np.array([float(disc["u_px"]), float(disc["v_px"])])
        own = np.array([float(disc["own_u_px"]), float(disc["own_v_px"])])
        answers = {"Pivotsight `circles`": own}
        answers.update((name, way(image)) for name, way in WAYS.items())
        for name, answer in answers.items():
            wrong = answer is None or not np.linalg.norm(np.asarray(answer) - truth) < 20
            error = None if wrong else np.asarray(answer) - truth
            errors.setdefault(name, {}).setdefault(disc["difficulty"], []).append(error)

    def cell(list_):
        good = [e for e in list_ if e is not None]
        rms = np.sqrt(np.mean(np.square(good))) if good else np.nan
        return f"{rms:.4f}" + (f", {len(list_) - len(good)} of {len(list_)} failed" if len(good) < len(list_) else "")

    print(f"rms of a coordinate of the centre, px; OpenCV {cv2.__version__}, scikit-image {skimage.__version__}\n")
    print("| | blur 1.2, contrast 120, noise 2 | blur 4, contrast 60, noise 6 |\n|---|---|---|")
    for name, by in errors.items():
        print(f"| {name} | {cell(by['easy'])} | {cell(by['hard'])} |")
    bound = [n / c * np.sqrt(2 * b / (np.sqrt(np.pi) * RADIUS)) for b, c, n in [(1.2, 120, 2), (4, 60, 6)]]
    print(f"| Cramer-Rao bound | {bound[0]:.4f} | {bound[1]:.4f} |")


main(Path(sys.argv[1]))
