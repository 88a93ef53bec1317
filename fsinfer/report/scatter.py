"""The cloud to turn with the mouse or a finger: a plotly scatter with plotly's script inside the page."""

from __future__ import annotations

import importlib.util

import numpy as np

from fsinfer.cloud import PointCloud

# What a phone still turns smoothly.
MAX_POINTS = 60_000


def scatter(cloud: PointCloud, unit: str, *, max_points: int = MAX_POINTS) -> str | None:
    """Return HTML with an interactive 3-D scatter that needs no network; None where plotly is not installed.

    Parameters
    ----------
    cloud: z up; at most ``max_points`` of it are drawn, chosen evenly at random but always the same.
    unit: for the axis titles.
    """
    if importlib.util.find_spec("plotly") is None:
        return None
    import plotly.graph_objects as go

    low, high = np.percentile(cloud.xyz, [0.5, 99.5], axis=0)
    margin = 0.02 * (high - low)
    cloud = cloud.select(np.all((cloud.xyz >= low - margin) & (cloud.xyz <= high + margin), axis=1))
    if len(cloud) > max_points:
        cloud = cloud.select(np.random.default_rng(0).choice(len(cloud), max_points, replace=False))
    x, y, z = np.round(cloud.xyz, 4).T.astype(np.float32)
    if cloud.rgb is None:
        marker = {"size": 1.6, "color": z, "colorscale": "Viridis"}
    else:
        marker = {"size": 1.6, "color": [f"rgb({r},{g},{b})" for r, g, b in cloud.rgb.tolist()]}
    figure = go.Figure(go.Scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, hoverinfo="x+y+z"))
    figure.update_layout(
        template=None,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        scene={
            "aspectmode": "data",
            "xaxis": {"title": {"text": f"x ({unit})"}},
            "yaxis": {"title": {"text": f"y ({unit})"}},
            "zaxis": {"title": {"text": f"z ({unit})"}},
        },
    )
    html = figure.to_html(
        full_html=False,
        include_plotlyjs=True,
        include_mathjax=False,
        default_height="100%",
        config={"displaylogo": False, "responsive": True, "showSendToCloud": False},
    )
    return f'<div class="scatter">{html}</div>'
