"""Runs on disk: a zarr store that grows chunk by chunk along time and opens whenever the writer is killed.

The root's `zarr.json` carries the consolidated metadata, that is the shapes of all arrays in one file. A chunk is
written in this order: first its values, then that one file is replaced. Whoever opens the store sees either all of a
chunk or nothing of it, because xarray and zarr read the shapes from the root. The arrays' own metadata follow when the
run is finished; until then they promise no frames, never more than was written.
"""

from __future__ import annotations

import copy
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

from gelbot.errors import BadInput

ROOT = "zarr.json"
TIME = "time"


class RunStore:
    """The writer of one run. Make it with `RunStore.create`; it is the only writer of its folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.frame_count = 0
        self._root: dict[str, Any] = json.loads((folder / ROOT).read_text())
        self._group = zarr.open_group(folder, mode="r+", use_consolidated=False)
        self._arrays: dict[str, zarr.Array[Any]] = {}

    @classmethod
    def create(cls, folder: Path, static: xr.Dataset) -> RunStore:
        """Make the store with everything that does not depend on time; `static.attrs` must be plain JSON values.

        Raises `BadInput` when `folder` exists.
        """
        folder = Path(folder)
        if folder.exists():
            raise BadInput("run folder", str(folder), "a folder that does not exist yet", "another --out folder")
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = folder.with_name(f".{folder.name}.{os.getpid()}.new")
        try:
            _with_plain_strings(static).to_zarr(draft, mode="w", zarr_format=3, consolidated=False)
            _replace(draft / ROOT, _consolidated(draft))
            draft.rename(folder)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
        return cls(folder)

    def append(self, chunk: xr.Dataset) -> None:
        """Add `chunk`, all of whose variables begin with the dimension `time`; it is safe once this returns.

        The first chunk fixes the variables, their shapes and the length of a chunk on disk. Raises `ValueError` when a
        later one has other variables.
        """
        if not self._arrays:
            self._arrays = {str(name): self._new_array(str(name), v) for name, v in chunk.variables.items()}
        if set(self._arrays) != {str(name) for name in chunk.variables}:
            raise ValueError(f"a chunk with {sorted(map(str, chunk.variables))}; expected {sorted(self._arrays)}")
        end = self.frame_count + chunk.sizes[TIME]
        root = copy.deepcopy(self._root)
        members = root["consolidated_metadata"]["metadata"]
        for name, array in self._arrays.items():
            members[name]["shape"][0] = end
            # As long in memory as it will be on disk: the values go where the metadata will say that they are.
            longer = zarr.Array.from_dict(array.store_path, members[name])
            longer[self.frame_count : end] = np.asarray(chunk[name].values)
        _replace(self.folder / ROOT, root)
        self._root, self.frame_count = root, end

    def finish(self, status: str) -> None:
        """Write the run's `status`: "finished", or "failed: ..." with the reason."""
        for name in self._arrays:
            _replace(self.folder / name / ROOT, self._root["consolidated_metadata"]["metadata"][name])
        self._root["attributes"]["status"] = status
        _replace(self.folder / ROOT, self._root)

    def _new_array(self, name: str, variable: xr.Variable) -> zarr.Array[Any]:
        if variable.dims[:1] != (TIME,):
            raise ValueError(f"{name} has the dimensions {variable.dims}; the first one must be time")
        array = self._group.create_array(
            name,
            shape=(0, *variable.shape[1:]),
            chunks=tuple(max(1, n) for n in variable.shape),
            dtype=variable.dtype,
            fill_value=np.nan if variable.dtype.kind == "f" else 0,
            dimension_names=[str(d) for d in variable.dims],
            attributes=dict(variable.attrs),
        )
        # Only in memory: the root on disk does not name the array before its values are there.
        self._root["consolidated_metadata"]["metadata"][name] = json.loads((self.folder / name / ROOT).read_text())
        return array


def open_run(folder: Path) -> xr.Dataset:
    """The run in `folder`, values read when they are used; all frames up to the last complete chunk.

    Raises `BadInput` when there is no run.
    """
    folder = Path(folder)
    if not (folder / ROOT).is_file():
        raise BadInput("run folder", str(folder), "a folder written by gelbot run (run.zarr)")
    return xr.open_zarr(folder, consolidated=True, chunks=None)


def _with_plain_strings(static: xr.Dataset) -> xr.Dataset:
    """Labels as variable-length strings: zarr 3 has no lasting format for the fixed-length ones of numpy."""
    labels = {name: v.astype(object) for name, v in static.variables.items() if v.dtype.kind == "U"}
    coords = {name: v for name, v in labels.items() if name in static.coords}
    return static.assign({n: v for n, v in labels.items() if n not in coords}).assign_coords(coords)


def _consolidated(folder: Path) -> dict[str, Any]:
    root = json.loads((folder / ROOT).read_text())
    members = {p.parent.name: json.loads(p.read_text()) for p in sorted(folder.glob(f"*/{ROOT}"))}
    root["consolidated_metadata"] = {"kind": "inline", "must_understand": False, "metadata": members}
    return root


def _replace(path: Path, content: dict[str, Any]) -> None:
    """Put `content` at `path` in one indivisible step."""
    draft = path.with_name(f"{path.name}.new")
    draft.write_text(json.dumps(content))
    draft.replace(path)
