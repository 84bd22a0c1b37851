"""Head of a document: its key ``format`` and its other keys, found without building its values."""

from __future__ import annotations

from dataclasses import dataclass

import yaml

from lmkit.io.documents import MAX_VALUES, PlainLoader, without_opencv_line


@dataclass(frozen=True)
class DocumentHead:
    """Keys of the first YAML or JSON document of a text; none if the text is not such a document.

    Attributes:
        format: value of the key ``format``, or an empty text.
        keys: all keys of the outermost mapping.
    """

    format: str
    keys: frozenset[str]


def head_of(text: str) -> DocumentHead:
    """Head of a text; keys after a syntax error are missing.

    Examples:
        >>> head_of('{"name": "lmkit-map/1", "format": "lmkit-rig/1"}').format
        'lmkit-rig/1'
    """
    keys: list[str] = []
    format_, depth, key = "", 0, None
    try:
        for count, event in enumerate(yaml.parse(without_opencv_line(text), Loader=PlainLoader)):
            if isinstance(event, yaml.DocumentEndEvent) or count > MAX_VALUES:
                break
            if depth == 0:
                if isinstance(event, yaml.SequenceStartEvent | yaml.ScalarEvent):
                    break
                depth += isinstance(event, yaml.MappingStartEvent)
                continue
            if depth == 1 and key is None and isinstance(event, yaml.ScalarEvent):
                key = event.value
                keys.append(key)
                continue
            if depth == 1 and key == "format" and isinstance(event, yaml.ScalarEvent) and not format_:
                format_ = event.value
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth == 1:
                key = None
    except yaml.YAMLError:
        pass
    return DocumentHead(format_, frozenset(keys))
