"""Results as JSON that people can read too."""

from __future__ import annotations

import json
import math
import re
from typing import Any

FLAT_LIST = re.compile(r"\[\n\s+([^\[\]{}]*?)\n\s*\]")


def as_text(value: dict[str, Any]) -> str:
    """`value` as JSON, lists of plain values on one line each; what is not finite is null."""
    text = json.dumps(_finite(value), indent=2, allow_nan=False)
    return FLAT_LIST.sub(lambda found: "[" + re.sub(r",\n\s+", ", ", found[1]) + "]", text) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
