"""A stand-in for the parts of ROS 2 that the example node uses, in one process without a network.

Messages are made from ROS 2's own definitions and check types as its generated classes do. Classes
and functions have the signatures of rclpy, message_filters and tf2_ros (Humble to Rolling).
"""

from __future__ import annotations

import array
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

_STORE = get_typestore(Stores.ROS2_HUMBLE)
_KINDS = {"string": str, "bool": bool, "float32": float, "float64": float}  # others are int


def message_class(name: str) -> type:
    """The class of a message, such as `sensor_msgs/msg/Image`."""
    fields: dict[str, Any] = dict(_STORE.fielddefs[name][1])

    def initialise(self: Any, **values: Any) -> None:
        for field, kind in fields.items():
            setattr(self, field, values.pop(field, None) or _default(kind))
        assert not values, f"{name} has no {sorted(values)}"

    def assign(self: Any, field: str, value: Any) -> None:
        assert field in fields, f"{name} has no {field}"
        _check(fields[field], value, f"{name}.{field}")
        object.__setattr__(self, field, value)

    return type(name.rpartition("/")[2], (), {"__init__": initialise, "__setattr__": assign})


def _default(kind: Any) -> Any:
    node, content = kind
    if node is Nodetype.NAME:
        return _class_of(content)()
    if node is Nodetype.BASE:
        return _KINDS.get(content[0], int)()
    element, length = content
    if element[1][0] == "uint8":
        return array.array("B", bytes(length))
    return np.zeros(length) if node is Nodetype.ARRAY else []


def _check(kind: Any, value: Any, where: str) -> None:
    """As the setters of generated messages, which refuse other types."""
    node, content = kind
    if node is Nodetype.NAME:
        assert type(value).__name__ == content.rpartition("/")[2], where
    elif node is Nodetype.BASE:
        expected = _KINDS.get(content[0], int)
        assert isinstance(value, expected), f"{where} is a {type(value).__name__}"
    elif node is Nodetype.ARRAY:
        assert isinstance(value, np.ndarray) and value.dtype == np.float64, where
        assert value.shape == (content[1],), f"{where} has shape {value.shape}"


_CLASSES: dict[str, type] = {}


def _class_of(name: str) -> type:
    if name not in _CLASSES:
        _CLASSES[name] = message_class(name)
    return _CLASSES[name]


class Parameter:
    def __init__(self, name: str, type_: Any = None, value: Any = None) -> None:
        self.name, self.value = name, value


class Logger:
    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def _log(self, severity: str, message: str, **options: Any) -> None:
        assert set(options) <= {"throttle_duration_sec", "skip_first", "once"}
        assert isinstance(message, str)
        self.lines.append((severity, message))

    def info(self, message: str, **options: Any) -> None:
        self._log("info", message, **options)

    def warning(self, message: str, **options: Any) -> None:
        self._log("warning", message, **options)

    def error(self, message: str, **options: Any) -> None:
        self._log("error", message, **options)


class Publisher:
    def __init__(self, kind: type) -> None:
        self._kind = kind
        self.messages: list[Any] = []

    def publish(self, msg: Any) -> None:
        assert isinstance(msg, self._kind)
        self.messages.append(msg)


class Node:
    """A node whose subscriptions are fed with `deliver`."""

    def __init__(
        self,
        node_name: str,
        *,
        context: Any = None,
        cli_args: list[str] | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        start_parameter_services: bool = True,
        parameter_overrides: list[Parameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
    ) -> None:
        self.name = node_name
        self._overrides = {each.name: each.value for each in parameter_overrides or []}
        self._logger = Logger()
        self.published: dict[str, Publisher] = {}
        self._callbacks: dict[str, list[tuple[type, Callable[[Any], None]]]] = {}
        self.is_destroyed = False

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> Parameter:
        found = self._overrides.get(name, value)
        assert type(found) is type(value), f"{name} is a {type(value).__name__}"
        return Parameter(name, value=found)

    def get_logger(self) -> Logger:
        return self._logger

    def create_publisher(
        self,
        msg_type: type,
        topic: str,
        qos_profile: Any,
        *,
        callback_group: Any = None,
        event_callbacks: Any = None,
        qos_overriding_options: Any = None,
        publisher_class: type = Publisher,
    ) -> Publisher:
        return self.published.setdefault(topic, Publisher(msg_type))

    def create_subscription(
        self,
        msg_type: type,
        topic: str,
        callback: Callable[[Any], None],
        qos_profile: Any,
        *,
        callback_group: Any = None,
        event_callbacks: Any = None,
        qos_overriding_options: Any = None,
        raw: bool = False,
    ) -> object:
        self._callbacks.setdefault(topic, []).append((msg_type, callback))
        return object()

    def destroy_subscription(self, subscription: Any) -> bool:
        return True

    def destroy_node(self) -> None:
        self.is_destroyed = True

    def deliver(self, topic: str, message: Any) -> None:
        """Hand a message to the subscriptions of a topic, of which there must be one."""
        for kind, callback in self._callbacks[topic]:
            assert isinstance(message, kind)
            callback(message)


class SimpleFilter:
    def __init__(self) -> None:
        self.callbacks: list[tuple[Callable[..., None], tuple[Any, ...]]] = []

    def registerCallback(self, cb: Callable[..., None], *args: Any) -> int:  # noqa: N802
        self.callbacks.append((cb, args))
        return len(self.callbacks) - 1

    def signalMessage(self, *msg: Any) -> None:  # noqa: N802
        for callback, arguments in self.callbacks:
            callback(*msg, *arguments)


class Subscriber(SimpleFilter):
    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__()
        node, kind, topic = args
        kwargs.setdefault("qos_profile", 10)
        self.sub = node.create_subscription(kind, topic, self.signalMessage, **kwargs)


class ApproximateTimeSynchronizer(SimpleFilter):
    """Pairs the messages of two filters whose stamps differ by less than `slop` seconds."""

    def __init__(
        self,
        fs: list[SimpleFilter],
        queue_size: int,
        slop: float,
        allow_headerless: bool = False,
    ) -> None:
        super().__init__()
        self._queues: list[dict[int, Any]] = [{} for _ in fs]
        self._size, self._slop_ns = queue_size, slop * 1e9
        for number, each in enumerate(fs):
            each.registerCallback(self._add, number)

    def _add(self, message: Any, number: int) -> None:
        stamp = message.header.stamp
        now_ns = stamp.sec * 10**9 + stamp.nanosec
        own, other = self._queues[number], self._queues[1 - number]
        own[now_ns] = message
        while len(own) > self._size:
            del own[min(own)]
        near = [ns for ns in other if abs(ns - now_ns) < self._slop_ns]
        if near:
            partner = other.pop(min(near, key=lambda ns: abs(ns - now_ns)))
            pair = [own.pop(now_ns), partner]
            self.signalMessage(*(pair if number == 0 else reversed(pair)))


class TransformException(Exception):
    pass


class Buffer:
    """Transforms by (target, source) that a test has put there."""

    known: dict[tuple[str, str], Any] = {}

    def __init__(self, cache_time: Any = None, node: Any = None) -> None: ...

    def lookup_transform(
        self, target_frame: str, source_frame: str, time: Any, timeout: Any = None
    ) -> Any:
        if (target_frame, source_frame) not in self.known:
            raise TransformException(f'"{source_frame}" does not exist')
        return self.known[target_frame, source_frame]


class TransformListener:
    def __init__(
        self,
        buffer: Buffer,
        node: Node,
        *,
        spin_thread: bool = False,
        qos: Any = None,
        static_qos: Any = None,
    ) -> None: ...


class TransformBroadcaster:
    def __init__(self, node: Node, qos: Any = 100) -> None:
        self._publisher = node.create_publisher(_class_of("tf2_msgs/msg/TFMessage"), "/tf", qos)

    def sendTransform(self, transform: Any) -> None:  # noqa: N802
        several = transform if isinstance(transform, list) else [transform]
        self._publisher.publish(_class_of("tf2_msgs/msg/TFMessage")(transforms=several))


class Time:
    def __init__(
        self, *, seconds: float = 0, nanoseconds: int = 0, clock_type: Any = None
    ) -> None: ...


class ExternalShutdownException(Exception):
    pass


def _init(*, args: Any = None, context: Any = None, domain_id: int | None = None) -> None: ...


def _spin(node: Node, executor: Any = None) -> None:
    raise ExternalShutdownException


def _try_shutdown(*, context: Any = None, uninstall_handlers: Any = None) -> None: ...


def modules() -> dict[str, ModuleType]:
    """The stand-ins by the names under which they are imported."""
    contents: dict[str, dict[str, Any]] = {
        "rclpy": {"init": _init, "spin": _spin, "try_shutdown": _try_shutdown},
        "rclpy.node": {"Node": Node},
        "rclpy.executors": {"ExternalShutdownException": ExternalShutdownException},
        "rclpy.qos": {"qos_profile_sensor_data": object()},
        "rclpy.time": {"Time": Time},
        "message_filters": {
            "Subscriber": Subscriber,
            "ApproximateTimeSynchronizer": ApproximateTimeSynchronizer,
        },
        "tf2_ros": {
            "Buffer": Buffer,
            "TransformBroadcaster": TransformBroadcaster,
            "TransformException": TransformException,
            "TransformListener": TransformListener,
        },
    }
    for package in ("sensor_msgs", "nav_msgs", "geometry_msgs"):
        names = [n for n in _STORE.fielddefs if n.startswith(f"{package}/msg/")]
        contents[package] = {}
        contents[f"{package}.msg"] = {n.rpartition("/")[2]: _class_of(n) for n in names}
    made = {name: ModuleType(name) for name in contents}
    for name, members in contents.items():
        vars(made[name]).update(members)
    return made


def message(name: str) -> Any:
    """A new message, such as of `sensor_msgs/msg/Image`."""
    return _class_of(name)()
