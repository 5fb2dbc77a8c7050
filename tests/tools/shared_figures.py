#!/usr/bin/env python3
"""Measures a case a second time, with code that shares nothing with the program, and compares with its report.json.

    shared_figures.py TOOLS coarse SECTIONS.json OUT.json     contours of few corners, whose solid lies beside them
    shared_figures.py TOOLS compare CASE LUMEN.stl            ends with 1 where a figure is off by more than 2e-3 mm

TOOLS is the folder of the checking tools. The lumen is cut at every plane of the contours; outlines are walked and measured by shapely.
Says so and ends with 0 where a Python package is missing.
"""

import json
import pathlib
import sys

N_CORNERS = 24
STEP_MM = 0.05
MOST_MM = 2e-3
MOST_DICE = 1e-3

try:
    sys.path.insert(0, sys.argv[1])
    import numpy as np
    import overlap
    import score_sections
    import sections_io
    import shapely
    import stl_io
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(0)


def section(triangles, z):
    """The region within a surface at a height."""
    low, high = triangles[:, :, 2].min(1), triangles[:, :, 2].max(1)
    lines = np.round(overlap.segments(triangles[(low <= z) & (high > z)], z), 7)
    lines = [line for line in lines if not np.array_equal(line[0], line[1])]
    rings = shapely.polygonize([shapely.linestrings(line) for line in lines])
    region = shapely.Polygon()
    for ring in rings.geoms:
        region = region.symmetric_difference(shapely.Polygon(ring.exterior))
    return region


def rings_of(region):
    polygons = region.geoms if hasattr(region, "geoms") else [region]
    return [np.asarray(ring.coords) for p in polygons for ring in (p.exterior, *p.interiors)]


def walked(rings):
    """Points along outlines, half a step in first."""
    lines = [shapely.linearrings(ring) for ring in rings]
    places = [shapely.line_interpolate_point(line, np.arange(0.5 * STEP_MM, line.length, STEP_MM)) for line in lines]
    return np.vstack([shapely.get_coordinates(p) for p in places])


def one_way(points, rings, region, sign):
    shapely.prepare(region)
    inside = shapely.contains_xy(region, points[:, 0], points[:, 1])
    return sign * np.where(inside, -1.0, 1.0) * score_sections.distances(points, rings)


def figures(signed):
    far = np.abs(signed)
    return {"mean_mm": far.mean(), "rms_mm": np.sqrt((signed**2).mean()), "p95_mm": np.percentile(far, 95),
            "max_mm": far.max(), "bias_mm": signed.mean()}


def least_width(points):
    hull = np.asarray(shapely.convex_hull(shapely.multipoints(points)).exterior.coords)
    edges = np.diff(hull, axis=0)
    normals = np.c_[edges[:, 1], -edges[:, 0]] / np.linalg.norm(edges, axis=1)[:, None]
    spread = hull @ normals.T
    return (spread.max(0) - spread.min(0)).min()


def widths(region):
    """Equivalent, least and largest diameter, mm."""
    points = np.vstack(rings_of(region))
    largest = np.linalg.norm(points[:, None] - points[None], axis=2).max()
    return {"equivalent_diameter_mm": np.sqrt(4 * region.area / np.pi), "minimum_diameter_mm": least_width(points),
            "maximum_diameter_mm": largest}


class Judge:
    def __init__(self):
        self.worst, self.n, self.failed = {}, 0, 0

    def __call__(self, name, own, reported, most):
        off = abs(own - reported)
        self.n += 1
        key = name.split(" ")[-1]
        self.worst[key] = max(off, self.worst.get(key, 0.0))
        if not off <= most:
            self.failed += 1
            print(f"FAIL {name}: {reported:.6f} in the report, {own:.6f} measured here")


def compare(case, stl):
    report = json.loads((case / "report" / "report.json").read_text())
    planes = sections_io.read(case / "sections.json")
    triangles = stl_io.read(stl)
    judge, pooled = Judge(), []
    block = report["reconstruction"]
    measures = {}
    for branch in report["anatomy"]["branches"]:
        for stage in branch["stages"]:
            for plane in stage["planes"]:
                measures.setdefault((stage["stage"], plane["plane"]), []).append(plane)
    for k, (z, contours) in enumerate(planes):
        reference, tested = score_sections.region(contours), section(triangles, z)
        sides = rings_of(reference), rings_of(tested)
        signed = np.r_[one_way(walked(sides[1]), sides[0], reference, 1.0), one_way(walked(sides[0]), sides[1], tested, -1.0)]
        pooled.append(signed)
        for name, own in figures(signed).items():
            judge(f"plane {k} {name}", own, block["planes"][k][name], MOST_MM)
        dice = 2 * reference.intersection(tested).area / (reference.area + tested.area)
        judge(f"plane {k} dice", dice, block["planes"][k]["dice"], MOST_DICE)
        for stage, region in (("contours", reference), ("solid", tested)):
            pieces = list(region.geoms) if hasattr(region, "geoms") else [region]
            for told in measures[stage, k]:
                at = shapely.Point(told["centre_xy_mm"])
                own = min(pieces, key=lambda piece: piece.distance(at))
                for name, value in widths(own).items():
                    judge(f"plane {k} {stage} {name}", value, told[name], MOST_MM)
    for name, own in figures(np.concatenate(pooled)).items():
        judge(f"overall {name}", own, block["overall"][name], MOST_MM)
    print(f"mean of the reconstruction {block['overall']['mean_mm']:.4f} mm; {judge.n} figures, farthest off: "
          + ", ".join(f"{name} {off:.5f}" for name, off in judge.worst.items()))
    return 1 if judge.failed else 0


def main():
    if sys.argv[2] == "coarse":
        planes = sections_io.read(sys.argv[3])
        sections_io.write(sys.argv[4], [(z, [sections_io.resample(c, N_CORNERS) for c in cs]) for z, cs in planes])
        return 0
    return compare(pathlib.Path(sys.argv[3]), sys.argv[4])


if __name__ == "__main__":
    sys.exit(main())
