"""What a launch file of ROS 2 starts: its processes and nodes, one JSON object a line.

ROS 2's `launch` is not to be had from PyPI. This is a double of the part of its interface that the launch
files use, written from its documentation: arguments and their defaults, substitutions, conditions,
inclusion. Arguments: the file, then name:=value.
"""
import importlib.util
import json
import sys
import types

context = {}


class LaunchConfiguration:
    def __init__(self, name):
        self.name = name

    def perform(self, context):
        return context[self.name]


def text(value):
    return value.perform(context) if hasattr(value, 'perform') else str(value)


class Action:
    def __init__(self, *rest, condition=None, **more):
        self.rest, self.condition, self.more = rest, condition, more

    def visit(self):
        if self.condition is None or self.condition.holds():
            self.act()


class DeclareLaunchArgument(Action):
    def act(self):
        assert self.more['description']
        context.setdefault(self.rest[0], self.more['default_value'])


class ExecuteProcess(Action):
    def act(self):
        say(process=[text(word) for word in self.more['cmd']],
            respawn=bool(self.more.get('respawn')))


class Node(Action):
    def act(self):
        say(node=[self.more['package'], self.more['executable']],
            arguments=[text(word) for word in self.more.get('arguments', [])],
            parameters=sorted(key for some in self.more.get('parameters', []) for key in some))


class OpaqueFunction(Action):
    def act(self):
        for action in self.more['function'](context):
            action.visit()


class IncludeLaunchDescription(Action):
    def act(self):
        outer = dict(context)
        context.update({name: text(value) for name, value in self.more.get('launch_arguments', [])})
        describe(self.rest[0].path)
        context.clear()
        context.update(outer)


class IfCondition:
    def __init__(self, value):
        self.value = value

    def holds(self):
        return text(self.value).lower() in ('true', '1')


class PythonLaunchDescriptionSource:
    def __init__(self, path):
        self.path = path


class Shutdown(Action):
    pass


class LaunchDescription(list):
    pass


def say(**what):
    print(json.dumps(what), flush=True)


def describe(path):
    spec = importlib.util.spec_from_file_location('described', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for action in module.generate_launch_description():
        action.visit()


for name, classes in (
        ('launch', [LaunchDescription]),
        ('launch.actions', [DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription,
                            OpaqueFunction, Shutdown]),
        ('launch.conditions', [IfCondition]),
        ('launch.launch_description_sources', [PythonLaunchDescriptionSource]),
        ('launch.substitutions', [LaunchConfiguration]),
        ('launch_ros', []),
        ('launch_ros.actions', [Node])):
    module = types.ModuleType(name)
    for made in classes:
        setattr(module, made.__name__, made)
    sys.modules[name] = module
context.update(word.split(':=', 1) for word in sys.argv[2:])
describe(sys.argv[1])
