"""CDR, the encoding of ROS 2 messages, and the hashes of their types, by rosbags."""

from __future__ import annotations

from typing import Any

import numpy as np

from lmkit.live.ros.messages import DEFINITIONS, Values


class Cdr:
    """Converts plain values to bytes and back."""

    def __init__(self) -> None:
        from rosbags.interfaces import Nodetype
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._store: Any = get_typestore(Stores.ROS2_JAZZY)
        self._base, self._name, self._array = Nodetype.BASE, Nodetype.NAME, Nodetype.ARRAY
        types: dict[str, Any] = {}
        for name, text in DEFINITIONS.items():
            types.update(get_types_from_msg(text, name))
        self._store.register({name: value for name, value in types.items() if name not in self._store.fielddefs})

    def encode(self, type_name: str, values: Values) -> bytes:
        """Bytes of a message, with the header of four bytes; little endian."""
        return bytes(self._store.serialize_cdr(self._object(type_name, values), type_name, little_endian=True))

    def decode(self, type_name: str, data: bytes) -> Values:
        """Values of a message; bytes of images stay an array."""
        values: Values = _plain(self._store.deserialize_cdr(data, type_name))
        return values

    def decode_arrays(self, type_name: str, data: bytes) -> Any:
        """The message in the form of rosbags, with arrays unchanged."""
        return self._store.deserialize_cdr(data, type_name)

    def definition(self, type_name: str) -> str:
        """Definition of a type, with the definitions of its member types."""
        return str(self._store.generate_msgdef(type_name, ros_version=2)[0])

    def type_hash(self, type_name: str) -> str:
        """Hash of a type in ROS 2 from Iron on: ``RIHS01_...``."""
        return str(self._store.hash_rihs01(type_name))

    def _object(self, type_name: str, values: Values) -> Any:
        fields = {
            name: self._field(kind, values[name])
            for name, kind in self._store.fielddefs[type_name][1]
            if name in values
        }
        return self._store.types[type_name](**fields)

    def _field(self, kind: Any, value: Any) -> Any:
        node, what = kind
        if node == self._base:
            return value
        if node == self._name:
            return self._object(what, value)
        inner = what[0]
        if inner[0] == self._name:
            return [self._object(inner[1], item) for item in value]
        if inner[1][0] == "string":
            return list(value)
        return np.asarray(value, dtype=inner[1][0])


def _plain(value: Any) -> Any:
    if hasattr(value, "__dataclass_fields__"):
        return {
            name: _plain(getattr(value, name)) for name in value.__dataclass_fields__ if not name.startswith("__")
        }
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) and value.dtype != np.uint8 else value
