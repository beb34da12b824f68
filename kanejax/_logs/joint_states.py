"""Log files in the format MCAP, as ROS 2 records them: messages of the type JointState."""

import functools
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kanejax._errors import LogError
from kanejax._logs.columns import listed
from kanejax._logs.tables import Samples, Table, package, shortened

_TIMES = ("time", "log_time", "publish_time")
_QUANTITIES = ("position", "velocity", "effort")


class _State(NamedTuple):
    """A message: times [s] in the order of _TIMES, names of the joints, and quantities in that of _QUANTITIES, some maybe empty."""

    times: tuple[float, float, float]
    joints: tuple[str, ...]
    values: tuple[Sequence[float | None], ...]


def mcap_table(path: Path, topic: str | None) -> Table:
    """Open an MCAP file as a table with a row for each message of a topic.

    The columns are "time", the stamp in the message's header; "log_time" and "publish_time" of the recorder; and
    "position_{joint}", "velocity_{joint}" and "effort_{joint}". Messages are encoded as ROS 2 does (CDR), or as JSON.
    """
    try:
        with path.open("rb") as stream:
            states = list(_states(stream, path, topic))
    except LogError:
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {shortened(error)}"
        raise LogError(
            f"{path}: not an MCAP file that can be read ({reason}); if the recording was cut off, repair it with `mcap recover`"
        ) from error
    joints = dict.fromkeys(joint for names in dict.fromkeys(state.joints for state in states) for joint in names)
    measured = [i for i in range(len(_QUANTITIES)) if any(len(state.values[i]) for state in states)]
    stamped = any(state.times[0] != 0.0 for state in states)
    keys = [*((i, None) for i in range(len(_TIMES)) if i or stamped), *((i, joint) for joint in joints for i in measured)]
    names = tuple(_TIMES[i] if joint is None else f"{_QUANTITIES[i]}_{joint}" for i, joint in keys)
    return Table(str(path), names, len(names), functools.partial(_samples, states, keys))


def _samples(states: list[_State], keys: list[tuple[int, str | None]], places: Sequence[int]) -> Samples:
    wanted = [keys[place] for place in places]
    joints = {joint for _, joint in wanted if joint is not None}
    kept = [state for state in states if not joints or not joints.isdisjoint(state.joints)]
    faults = {row: fault for row, state in enumerate(kept) if (fault := _fault(state)) is not None}
    others = len(states) - len(kept)
    notes = (f"{others} of {len(states)} messages have none of the joints and were left out",) if others else ()
    return Samples([np.array([_value(state, *key) for state in kept]) for key in wanted], faults, notes)


def _value(state: _State, i: int, joint: str | None) -> float:
    if joint is None:
        return state.times[i]
    places = _index(state.joints)
    value = state.values[i][places[joint]] if joint in places and len(state.values[i]) == len(state.joints) else None
    return np.nan if value is None else value


@functools.lru_cache(64)
def _index(joints: tuple[str, ...]) -> dict[str, int]:
    return {joint: place for place, joint in enumerate(joints)}


def _fault(state: _State) -> str | None:
    for quantity, values in zip(_QUANTITIES, state.values, strict=True):
        if len(values) not in (0, len(state.joints)):
            return f"the message has {len(values)} numbers of {quantity} for {len(state.joints)} joints"
    return None


def _states(stream: Any, path: Path, topic: str | None) -> Iterator[_State]:
    reader = package("mcap.reader", "mcap", str(path)).make_reader(stream)
    summary = reader.get_summary()
    # A recording that was cut off has no summary: its messages tell the topics.
    channels = (
        [(summary.schemas.get(channel.schema_id), channel) for channel in summary.channels.values()]
        if summary is not None and summary.channels
        else [(schema, channel) for schema, channel, _ in reader.iter_messages()]
    )
    types = {channel.topic: "no type" if schema is None else schema.name for schema, channel in channels}
    topic = _topic(types, topic, path)
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for schema, channel, message in reader.iter_messages(topics=[topic]):
        if channel.id not in decoders:
            decoders[channel.id] = _decoder(schema, channel, path)
        yield _state(decoders[channel.id](message.data), message)


def _topic(types: dict[str, str], topic: str | None, path: Path) -> str:
    if topic is not None and topic in types:
        return topic
    all_topics = listed([f"{name} ({kind})" for name, kind in sorted(types.items())])
    if topic is not None:
        raise LogError(f"{path}: there is no topic {topic!r}; the topics are: {all_topics}")
    found = [name for name, kind in types.items() if kind.endswith("JointState")]
    if len(found) != 1:
        raise LogError(f"{path}: {len(found)} topics have messages of type JointState; give topic=..., one of: {all_topics}")
    return found[0]


def _decoder(schema: Any, channel: Any, path: Path) -> Callable[[bytes], Any]:
    if channel.message_encoding == "json":
        return json.loads
    decode = package("mcap_ros2.decoder", "mcap", str(path)).DecoderFactory().decoder_for(channel.message_encoding, schema)
    if decode is None:
        schema_encoding = schema.encoding if schema else None
        raise LogError(
            f"{path}: topic {channel.topic!r} is encoded as {channel.message_encoding!r} with a schema in {schema_encoding!r}; "
            "JSON, and CDR with a schema in 'ros2msg', can be read"
        )
    return decode


def _state(content: Any, message: Any) -> _State:
    stamp = _field(_field(content, "header"), "stamp")
    seconds = next((_number(value) for key in ("sec", "secs") if (value := _field(stamp, key)) is not None), 0.0)
    rest = next((_number(value) for key in ("nanosec", "nsec", "nsecs") if (value := _field(stamp, key)) is not None), 0.0)
    times = (seconds + 1e-9 * rest, 1e-9 * message.log_time, 1e-9 * message.publish_time)
    joints = tuple(_field(content, "name") or ())
    if not all(isinstance(joint, str) for joint in joints):
        raise TypeError(f"the names of joints are {joints!r}, which are no texts")
    return _State(times, joints, tuple(_numbers(_field(content, quantity)) for quantity in _QUANTITIES))


def _numbers(values: Any) -> list[float | None]:
    return [None if value is None else _number(value) for value in (() if values is None else values)]


def _number(value: Any) -> float:
    """Of JSON, where anything may stand."""
    if isinstance(value, str | bool):
        raise TypeError(f"{value!r} is no number")
    return float(value)


def _field(content: Any, name: str) -> Any:
    """A field of a message, which JSON gives as a dictionary; None where it lacks."""
    return content.get(name) if isinstance(content, dict) else getattr(content, name, None)
