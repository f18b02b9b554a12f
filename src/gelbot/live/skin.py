"""A mesh that moves and changes its colours thirty times a second.

A mesh of viser has one colour and can be given new vertices cheaply; colours for each vertex would need a new model
file for each picture, and the body would flicker while it is read. So the faces are sorted by colour into a few bins,
each a mesh of its own with just the nodes that it needs. A face seldom changes its bin: most pictures are positions.
"""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from gelbot.live import colours

BINS = 12


class Skin:
    """The gel's surface in the scene under `name`: `faces` (3, f), coloured by a value 0 .. 1 for each face."""

    def __init__(self, scene: viser.SceneApi, name: str, faces: NDArray[np.int64]) -> None:
        self._scene, self._name, self._faces = scene, name, faces
        self._palette = colours.of_adsorption(BINS)
        self._bins = np.full(faces.shape[1], -1)
        self._nodes: list[NDArray[np.int64]] = [np.zeros(0, dtype=np.int64)] * BINS
        self._meshes: list[viser.MeshHandle | None] = [None] * BINS
        self._last: NDArray[np.float32] = np.zeros((0, 3), dtype=np.float32)

    def update(self, positions: NDArray[np.float64], values: NDArray[np.float64]) -> int:
        """Show nodes at `positions` (3, n) and `values` (f,). Returns how many meshes were sent."""
        vertices = np.ascontiguousarray(positions.T, dtype=np.float32)
        bins = np.clip(np.nan_to_num(values) * BINS, 0, BINS - 1).astype(np.int64)
        moved = not np.array_equal(vertices, self._last)
        changed = np.flatnonzero(bins != self._bins)
        touched = {*self._bins[changed].tolist(), *bins[changed].tolist()} - {-1}
        self._bins, self._last = bins, vertices
        sent = 0
        for number in range(BINS):
            if number in touched:
                self._sort(number, vertices)
            elif moved and len(self._nodes[number]):
                mesh = self._meshes[number]
                assert mesh is not None
                mesh.vertices = vertices[self._nodes[number]]
            else:
                continue
            sent += 1
        return sent

    def _sort(self, number: int, vertices: NDArray[np.float32]) -> None:
        """The faces of a bin are others than before: other nodes, another mesh."""
        mine = self._faces[:, self._bins == number]
        nodes, corners = np.unique(mine, return_inverse=True)
        self._nodes[number] = nodes
        mesh = self._meshes[number]
        if len(nodes) == 0:
            if mesh is not None:
                mesh.visible = False
            return
        faces = corners.reshape(mine.shape).T.astype(np.uint32)
        if mesh is None:
            red, green, blue = self._palette[number].tolist()
            self._meshes[number] = self._scene.add_mesh_simple(
                f"{self._name}/{number}", vertices[nodes], faces, color=(red, green, blue), flat_shading=True,
                side="double", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            return
        mesh.vertices, mesh.faces, mesh.visible = vertices[nodes], faces, True
