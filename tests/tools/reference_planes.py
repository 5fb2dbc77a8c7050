#!/usr/bin/env python3
"""Hashes of the HU planes of DICOM files, computed with pydicom: what the product's decoders are compared with.

    python reference_planes.py FOLDER > planes.txt

One line a file: BLAKE3 of its plane (f32, little endian, row by row, slope and intercept applied, padding as -1024 HU),
least, largest and summed value, and its name; in a folder below, that folder's name and the number of the file there, from 1:
names that scanners give hold identifiers. Needs pydicom, numpy, blake3, pylibjpeg with its libjpeg, openjpeg and rle plug-ins, pyjpegls.
"""

import pathlib
import sys

import blake3
import numpy
import pydicom

PADDING_HU = -1024.0


def plane(path):
    data_set = pydicom.dcmread(path)
    stored = data_set.pixel_array.astype(numpy.float64)
    slope = float(data_set.get("RescaleSlope", 1))
    hu = (stored * slope + float(data_set.get("RescaleIntercept", 0))).astype("<f4")
    padding = data_set.get("PixelPaddingValue")
    if padding is not None and data_set.Modality == "CT":
        limit = data_set.get("PixelPaddingRangeLimit", padding)
        hu[(stored >= min(padding, limit)) & (stored <= max(padding, limit))] = PADDING_HU
    return hu


def main(folder):
    paths = sorted(pathlib.Path(folder).glob("*.dcm"))
    named = [(path, path.name) for path in paths]
    for below in sorted(p for p in pathlib.Path(folder).iterdir() if p.is_dir()):
        named += [(path, f"{below.name}/{i}") for i, path in enumerate(sorted(below.glob("*.dcm")), 1)]
    for path, name in named:
        hu = plane(path)
        total = int(hu.astype(numpy.float64).sum())
        print(blake3.blake3(hu.tobytes()).hexdigest(), int(hu.min()), int(hu.max()), total, name)


if __name__ == "__main__":
    main(sys.argv[1])
