"""Stem maps for a GIS: GeoPackage always, GeoJSON only where the cloud's coordinates can be told in WGS84.

GeoJSON knows no other frame (RFC 7946, section 4), so local metres never go into one. A GeoPackage (OGC 12-128r19) is
an SQLite file, which the standard library writes.
"""

from __future__ import annotations

import json
import math
import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from dataclasses import astuple, fields
from pathlib import Path

from fsinfer.io.files import atomic_path, write_text
from fsinfer.trees.tree import Tree

_APPLICATION_ID = 0x47504B47  # "GPKG"
_VERSION = 10300
_LOCAL = -1  # "undefined Cartesian" of the standard: local metres
_WGS84 = 4326
_SYSTEMS = """CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY,
organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT)"""
_CONTENTS = """CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL,
identifier TEXT UNIQUE, description TEXT DEFAULT '',
last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id))"""
_COLUMNS = """CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL,
geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id))"""
_GEODETIC = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
    'UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
)


def write_maps(out: Path, trees: Sequence[Tree], *, epsg: int | None = None) -> list[Path]:
    """Write ``trees.gpkg``, and ``trees.geojson`` for a frame of WGS84; returns the paths.

    ``epsg`` is the code of the cloud's horizontal frame, None for local metres. A GeoJSON of an earlier run goes.
    """
    paths = [out / "trees.gpkg"]
    write_geopackage(paths[0], trees, epsg=epsg)
    geojson = out / "trees.geojson"
    if _zone(epsg) is not None:
        write_geojson(geojson, trees, epsg=epsg)
        paths.append(geojson)
    else:
        geojson.unlink(missing_ok=True)
    return paths


def write_geopackage(path: Path, trees: Sequence[Tree], *, epsg: int | None = None) -> None:
    """Write a layer ``trees`` of points with every column of ``trees.csv``."""
    names = [field.name for field in fields(Tree)]
    kinds = [_sql_kind(str(field.type)) for field in fields(Tree)]
    srs = _LOCAL if epsg is None else epsg
    with atomic_path(path) as temporary:
        temporary.unlink(missing_ok=True)
        with closing(sqlite3.connect(temporary)) as base, base:
            base.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
            base.execute(f"PRAGMA user_version = {_VERSION}")
            for table in (_SYSTEMS, _CONTENTS, _COLUMNS):
                base.execute(table)
            systems = [
                ("Undefined Cartesian SRS", -1, "NONE", -1, "undefined", "local metres"),
                ("Undefined geographic SRS", 0, "NONE", 0, "undefined", None),
                ("WGS 84 geodetic", _WGS84, "EPSG", _WGS84, _GEODETIC, None),
            ]
            if srs not in (-1, 0, _WGS84):
                # The definition by its code: programs look EPSG codes up in their own tables.
                systems.append((f"EPSG:{srs}", srs, "EPSG", srs, "undefined", None))
            base.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", systems)
            columns = ", ".join(f"{name} {kind}" for name, kind in zip(names, kinds, strict=True))
            base.execute(f"CREATE TABLE trees (fid INTEGER PRIMARY KEY AUTOINCREMENT, geom POINT, {columns})")
            box = [f(v) for f in (min, max) for v in zip(*((t.x_m, t.y_m) for t in trees), strict=True)] or [None] * 4
            base.execute(
                "INSERT INTO gpkg_contents (table_name, data_type, identifier, min_x, min_y, max_x, max_y, srs_id) "
                "VALUES ('trees', 'features', 'trees', ?, ?, ?, ?, ?)",
                (*box, srs),
            )
            base.execute("INSERT INTO gpkg_geometry_columns VALUES ('trees', 'geom', 'POINT', ?, 0, 0)", (srs,))
            marks = ", ".join("?" for _ in range(len(names) + 1))
            base.executemany(
                f"INSERT INTO trees (geom, {', '.join(names)}) VALUES ({marks})",
                [(_point(tree.x_m, tree.y_m, srs), *astuple(tree)) for tree in trees],
            )


def write_geojson(path: Path, trees: Sequence[Tree], *, epsg: int | None) -> None:
    """Write points in longitude and latitude (WGS84); ``epsg`` must be 4326 or a UTM zone of WGS84 (326xx, 327xx)."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [round(v, 9) for v in to_wgs84(tree.x_m, tree.y_m, epsg)]},
            "properties": {field.name: getattr(tree, field.name) for field in fields(Tree)},
        }
        for tree in trees
    ]
    write_text(path, json.dumps({"type": "FeatureCollection", "features": features}, indent=1, ensure_ascii=False))


def to_wgs84(x_m: float, y_m: float, epsg: int | None) -> tuple[float, float]:
    """Longitude and latitude in degrees of a position in a UTM zone of WGS84.

    Inverse transverse Mercator by Krueger's series to the third order of n (millimetres within a zone).
    """
    zone = _zone(epsg)
    if zone is None:
        msg = f"EPSG:{epsg} is no UTM zone of WGS84"
        raise ValueError(msg)
    number, south = zone
    if number == 0:
        return x_m, y_m
    a, f = 6378137.0, 1.0 / 298.257223563
    n = f / (2.0 - f)
    rectifying = a / (1.0 + n) * (1.0 + n**2 / 4.0 + n**4 / 64.0)
    xi = (y_m - (10_000_000.0 if south else 0.0)) / (0.9996 * rectifying)
    eta = (x_m - 500_000.0) / (0.9996 * rectifying)
    beta = (n / 2 - 2 * n**2 / 3 + 37 * n**3 / 96, n**2 / 48 + n**3 / 15, 17 * n**3 / 480)
    delta = (2 * n - 2 * n**2 / 3 - 2 * n**3, 7 * n**2 / 3 - 8 * n**3 / 5, 56 * n**3 / 15)
    waves = list(enumerate(beta, start=1))
    xi_, eta_ = (
        xi - sum(b * math.sin(2 * j * xi) * math.cosh(2 * j * eta) for j, b in waves),
        eta - sum(b * math.cos(2 * j * xi) * math.sinh(2 * j * eta) for j, b in waves),
    )
    conformal = math.asin(math.sin(xi_) / math.cosh(eta_))
    latitude = conformal + sum(d * math.sin(2 * j * conformal) for j, d in enumerate(delta, start=1))
    longitude = math.radians(6 * number - 183) + math.atan2(math.sinh(eta_), math.cos(xi_))
    return math.degrees(longitude), math.degrees(latitude)


def _zone(epsg: int | None) -> tuple[int, bool] | None:
    """UTM zone and whether it is south of the equator; zone 0 stands for longitude and latitude themselves."""
    if epsg is None:
        return None
    if epsg == _WGS84:
        return 0, False
    if 32601 <= epsg <= 32660:
        return epsg - 32600, False
    if 32701 <= epsg <= 32760:
        return epsg - 32700, True
    return None


def _point(x_m: float, y_m: float, srs: int) -> bytes:
    """GeoPackage geometry: header without envelope, little endian, then WKB."""
    return b"GP" + struct.pack("<BBi", 0, 1, srs) + struct.pack("<BIdd", 1, 1, x_m, y_m)


def _sql_kind(annotation: str) -> str:
    if "int" in annotation:
        return "INTEGER"
    return "TEXT" if "str" in annotation else "DOUBLE"
