# SPDX-License-Identifier: Apache-2.0
"""Write docs/topics.md, what every node publishes, subscribes to and serves: `python docs/write_topics.py`.

It is read from the source of each node's class and of those that it derives from. Types, names and QoS are evaluated
as the module evaluates them; what cannot be evaluated ends this program.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import sys
import textwrap
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import pages
from rclpy.action import ActionServer
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from write_nodes import NODES, node_class

from abrace.nodes import operator_commands
from abrace.nodes.graph_monitor import GraphMonitor, repeat_as_stop_button
from abrace.nodes.graph_operator import GraphOperator
from abrace_node import stop_listener
from abrace_node.lifecycle import AbraceLifecycleNode
from abrace_node.node import DIAGNOSTICS
from abrace_node.transport import KEPT_STREAM_QOS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

INTERFACES = pages.ROOT / "src/abrace_interfaces"

INTRODUCTION = f"""# Topics, services, actions

A name without a slash is relative to the namespace
(`rig` in launch files); `~` is the node's own name. *Last N*: so many messages are kept for a subscription that is
late. *Transient local*: the last ones are also sent to subscriptions that come later; others are volatile.

`logger` subscribes to the topics that it records, with the most that all publishers of a topic offer. `viewer`
subscribes to the topics that its clients have subscribed to, best effort, to transient local ones reliably.
`operator` publishes `/emergency_stop` only with its parameter `operate`. `replay` publishes the topics of its bag
with the QoS that was recorded, at least the last {KEPT_STREAM_QOS.depth} messages.

*Made from the nodes' source by `docs/write_topics.py`.*
"""
STANDARD = """Every node has ROS's services of parameters (`~/get_parameters`, `~/set_parameters`, ...), and
publishes `/rosout` and `/parameter_events`. A life cycle node ({nodes}) has those of the life cycle too:
`~/change_state`, `~/get_state` and `~/transition_event` (lifecycle_msgs)."""
CREATED = {
    "publish_on": "publishes",
    "create_publisher": "publishes",
    "subscribe_to": "subscribes",
    "create_subscription": "subscribes",
    "create_service": "serves",
}
"""What a method that creates something makes of its node."""
WRAPPERS = ("publish_on", "subscribe_to", "create_subscription", "call")
"""Methods that create what their own arguments say: what calls them is looked at."""
LOCAL_NAMES: Mapping[str, Mapping[str, Any]] = {
    "replay": {"topic": "brace_command"},
}
"""What names stand for that are no module's."""
WHEN = "when it is created"
"""Among the names: words in front of the QoS of what is created in one case alone."""
NOT_LISTED = ("topic.name",)
"""Topics whose names are in a bag: the introduction tells of them."""
BESIDE: Mapping[str, tuple[Any, ...]] = {
    "supervisor": (GraphMonitor,),
    "operator": (GraphOperator,),
}
"""What creates topics of a node in another class."""
COMMANDS = {
    "abrace stop": (operator_commands.stop,),
    "abrace status": (GraphOperator,),
    "abrace campaign": (repeat_as_stop_button,),
}


class Endpoint(NamedTuple):
    """What a node publishes, subscribes to, or serves."""

    act: str
    name: str
    type: str
    qos: str


def endpoints(source: Any, local_names: Mapping[str, Any]) -> Iterator[Endpoint]:
    """What a class or function creates; `local_names` says what names stand for that are no module's."""
    names = {**vars(sys.modules[source.__module__]), **local_names}
    tree = ast.parse(textwrap.dedent(inspect.getsource(source)))
    yield from _in(tree, names)
    if "StopListener(" in ast.unparse(tree):
        heard = "; ".join(dict.fromkeys(map(qos_words, stop_listener._QOS)))
        for name in stop_listener.TOPICS:
            yield Endpoint("subscribes", name, "std_msgs/msg/Bool", f"three subscriptions: {heard}")


def _in(tree: ast.AST, names: Mapping[str, Any]) -> Iterator[Endpoint]:
    if isinstance(tree, ast.FunctionDef) and tree.name in WRAPPERS:
        return
    if isinstance(tree, ast.For | ast.comprehension) and (values := _loop(tree, names)) is not None:
        for value in values:
            for inner in ast.iter_child_nodes(tree):
                yield from _in(inner, {**names, tree.target.id: value})  # type: ignore[attr-defined]
        return
    if isinstance(tree, ast.IfExp) and "lockstep" in ast.unparse(tree.test):
        names = {**names, WHEN: "in lockstep: "}
    if isinstance(tree, ast.Call):
        yield from _created(tree, names)
    for inner in ast.iter_child_nodes(tree):
        yield from _in(inner, names)


def _loop(tree: ast.For | ast.comprehension, names: Mapping[str, Any]) -> Any:
    """What a loop goes through; None: nothing that a module names."""
    if isinstance(tree.target, ast.Name) and isinstance(tree.iter, ast.Name):
        return names.get(tree.iter.id)
    return None


def _created(call: ast.Call, names: Mapping[str, Any]) -> Iterator[Endpoint]:
    """What one call creates."""
    called = call.func
    if isinstance(called, ast.Attribute) and called.attr in CREATED and len(call.args) > 1:
        if ast.unparse(call.args[1]) in NOT_LISTED:
            return
        act = CREATED[called.attr]
        qos = "" if act == "serves" else names.get(WHEN, "") + _qos(call.args[2 if act == "publishes" else 3], names)
        yield Endpoint(act, _value(call.args[1], names), type_words(_value(call.args[0], names)), qos)
    elif isinstance(called, ast.Name) and _is_action_server(names.get(called.id)):
        yield Endpoint("acts", _value(call.args[2], names), type_words(_value(call.args[1], names)), "")


def _is_action_server(value: Any) -> bool:
    return inspect.isclass(value) and issubclass(value, ActionServer)


def _value(expression: ast.expr, names: Mapping[str, Any]) -> Any:
    return eval(compile(ast.Expression(expression), "node", "eval"), dict(names))


def _qos(expression: ast.expr, names: Mapping[str, Any]) -> str:
    """QoS in words; of two by lockstep, both."""
    if isinstance(expression, ast.IfExp):
        lockstep, otherwise = (qos_words(_value(each, names)) for each in (expression.body, expression.orelse))
        return f"{otherwise}; in lockstep {lockstep}"
    return qos_words(_value(expression, names))


def qos_words(qos: QoSProfile | int) -> str:
    """A QoS in words."""
    if isinstance(qos, int):
        qos = QoSProfile(depth=qos)
    best_effort = qos.reliability == ReliabilityPolicy.BEST_EFFORT
    transient = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    kept = "keeps all" if qos.history == HistoryPolicy.KEEP_ALL else f"last {qos.depth}"
    words = ["best effort" if best_effort else "reliable", *(["transient local"] if transient else []), kept]
    if qos.lifespan.nanoseconds:
        words.append(f"lifespan {qos.lifespan.nanoseconds * 1e-9:g} s")
    return ", ".join(words)


def type_words(message: Any) -> str:
    """A message, service or action class as ROS names it."""
    package, kind = message.__module__.split(".")[:2]
    return f"{package}/{kind}/{message.__name__}"


@cache
def all_endpoints() -> dict[str, list[Endpoint]]:
    """What every node, and every command of an operator, publishes, subscribes to, and serves."""
    found: dict[str, list[Endpoint]] = {}
    for package, nodes in NODES.items():
        for name in nodes:
            module = importlib.import_module(f"{package}.nodes.{name}")
            ours = [each for each in node_class(module).__mro__ if each.__module__.startswith("abrace")]
            found[name] = _of((*ours, *BESIDE.get(name, ())), LOCAL_NAMES.get(name, {}))
    return found | {command: _of(sources, {}) for command, sources in COMMANDS.items()}


def _of(sources: tuple[Any, ...], local_names: Mapping[str, Any]) -> list[Endpoint]:
    return list(dict.fromkeys(each for source in sources for each in endpoints(source, local_names)))


def lifecycle_nodes() -> list[str]:
    """Names of the nodes with a life cycle."""
    modules = {name: f"{package}.nodes.{name}" for package, nodes in NODES.items() for name in nodes}
    return [
        name
        for name, module in modules.items()
        if issubclass(node_class(importlib.import_module(module)), AbraceLifecycleNode)
    ]


def table(title: str, header: str, acts: tuple[str, ...], cell: Callable[[str, dict[str, str]], str]) -> str:
    """A table of the names that nodes act on: one row a name, one `cell` for each act."""
    rows: dict[tuple[str, str], dict[str, dict[str, str]]] = {}
    for node, found in all_endpoints().items():
        for each in found:
            if each.act in acts:
                rows.setdefault((each.name, each.type), {act: {} for act in acts})[each.act][node] = each.qos
    cells = [
        (f"`{name}`", kind, *(cell(name, nodes) for nodes in by_act.values()))
        for (name, kind), by_act in sorted(rows.items())
    ]
    return f"{title}\n\n{pages.table(header.split(' | '), cells)}"


def with_qos(name: str, nodes: dict[str, str]) -> str:
    """The nodes that have one QoS, then those of the next one."""
    if name == DIAGNOSTICS and len(nodes) > len(COMMANDS) + len(BESIDE):
        return f"every node ({next(iter(nodes.values()))})"
    by_qos: dict[str, list[str]] = {}
    for node, qos in nodes.items():
        by_qos.setdefault(qos, []).append(f"`{node}`")
    return "; ".join(f"{', '.join(names)} ({qos})" for qos, names in by_qos.items()) or "-"


def names_alone(_: str, nodes: dict[str, str]) -> str:
    """The nodes."""
    return ", ".join(f"`{node}`" for node in nodes) or "-"


def definitions() -> str:
    """The messages and actions of abrace's own, as their files have them."""
    files = sorted([*INTERFACES.glob("msg/*.msg"), *INTERFACES.glob("srv/*.srv"), *INTERFACES.glob("action/*.action")])
    blocks = [
        f"### abrace_interfaces/{file.parent.name}/{file.stem}\n\n```text\n{file.read_text(encoding='utf-8')}```\n"
        for file in files
    ]
    return "\n".join(["## Messages and actions of abrace's own\n", *blocks])


def page() -> str:
    """The whole page."""
    nodes = ", ".join(f"`{name}`" for name in lifecycle_nodes())
    return "\n".join(
        [
            INTRODUCTION,
            table("## Topics", "topic | type | published by | subscribed to by", ("publishes", "subscribes"), with_qos),
            table("## Services", "service | type | node", ("serves",), names_alone),
            table("## Actions", "action | type | node", ("acts",), names_alone),
            pages.paragraph(STANDARD.format(nodes=nodes)),
            definitions(),
        ]
    )


if __name__ == "__main__":
    pages.write(__file__, page)
