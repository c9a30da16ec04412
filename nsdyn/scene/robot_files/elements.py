"""Rules for the attributes and children of elements: any that are not read are reported by name, new names too."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple
from xml.etree.ElementTree import Element

from nsdyn.scene.robot_files.xml import Report

POSE = "pos quat axisangle xyaxes zaxis euler"
"""Attributes of MJCF that place an element."""

WEB = "{http://www.w3.org/"
"""Prefix of attributes that are about the file, for instance its schema."""


class Rules(NamedTuple):
    """Rules for attributes and children of an element; names in no list are reported as changing the motion.

    Parameters
    ----------
    read : str
        Names that are used, that are reported elsewhere, or that cannot matter; elements among them are searched too.
    unused : str
        Names that do not change the motion and are reported as not used.
    missing : str
        Names without which the mechanism is another.
    still : mapping of str to str
        For any name, the values, separated by |, at which it changes nothing.
    many : str
        Elements that may occur several times; of any other element only the first is used.
    """

    read: str = ""
    unused: str = ""
    missing: str = ""
    still: Mapping[str, str] = {}
    many: str = ""


def changes_nothing(text: str | None, still: str) -> bool:
    """Whether a text equals one of the values in `still`, or the first numbers of one."""
    given, same = _values(text), [_values(value) for value in still.split("|")]
    return any(given == words[: len(given)] and bool(given) == bool(words) for words in same)


def _values(text: str | None) -> list[float | str]:
    """Return the words of a text, with numbers and truth values as numbers."""
    out: list[float | str] = []
    for word in (text or "").lower().split():
        try:
            out.append(float({"true": "1", "false": "0"}.get(word, word)))
        except ValueError:
            out.append(word)
    return out


def tell(elements: Iterable[Element], table: Mapping[str, Rules], report: Report, key: str = "") -> None:
    """Note attributes and children of `elements`, and of the children that are read, which `table` does not read.

    Keys of the table are tags, or "parent/tag" where a tag has several meanings; `key` is the key of `elements`.
    """
    found: dict[tuple[str, str, str], list[str]] = {}

    def look(element: Element, key: str, owner: str) -> None:
        rules, name = table[key], element.get("name", element.get("reference"))
        owner = f"{element.tag} {name!r}" if name is not None else owner
        of = "" if name is not None or not owner else f" of <{element.tag}>"
        texts: list[tuple[str, str, str | None]] = [
            (word, word, text) for word, text in element.attrib.items() if not word.startswith(WEB)
        ]
        texts += [(child.tag, f"<{child.tag.rpartition('}')[2]}>", child.text) for child in element]
        for word, shown, text in texts:
            if word in rules.still and changes_nothing(text, rules.still[word]):
                continue
            if word not in rules.read.split():
                kind = next((k for k in ("unused", "missing") if word in getattr(rules, k).split()), "dropped")
                note = f"{owner or element.tag}: {shown}{of}"
                found.setdefault((kind, key, word), []).append(note)
        seen: set[str] = set()
        for child in element:
            if child.tag in seen and child.tag in rules.read.split() and child.tag not in rules.many.split():
                found.setdefault(("dropped", key, f"{child.tag} again"), []).append(
                    f"{owner}: a second <{child.tag}>{of}"
                )
            seen.add(child.tag)
            inner = next((k for k in (f"{element.tag}/{child.tag}", child.tag) if k in table), "")
            if inner and child.tag in rules.read.split():
                look(child, inner, owner)

    for element in elements:
        look(element, key or element.tag, "")
    for (kind, _, _), notes in found.items():
        getattr(report, kind).append(notes[0] + (f" ({len(notes)})" if len(notes) > 1 else ""))
