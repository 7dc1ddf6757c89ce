"""Writes safetensors files whose bytes depend on their content only.

The `safetensors` package orders metadata by a hash that differs from run to run; here keys are sorted.
"""

import json
import struct
from pathlib import Path

import numpy as np

DTYPES = {np.dtype("<f4"): "F32", np.dtype("<f8"): "F64", np.dtype("<i4"): "I32", np.dtype("<u4"): "U32"}


def save(path: Path, tensors: dict, metadata: dict) -> None:
    """Writes `tensors` (name → array) and `metadata` (text → text) to `path`."""
    header, bodies, offset = {"__metadata__": {k: str(metadata[k]) for k in sorted(metadata)}}, [], 0
    for name in sorted(tensors):
        array = np.ascontiguousarray(tensors[name])
        body = array.tobytes()
        header[name] = dict(dtype=DTYPES[array.dtype], shape=list(array.shape), data_offsets=[offset, offset + len(body)])
        bodies.append(body)
        offset += len(body)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"".join(bodies))
