"""A ROS 2 graph's other side on Cyclone DDS, moved by lines on standard input; says one JSON object a line.

  read TOPIC KIND reliable|best volatile|latched   every message from now on
  call SERVICE [true|false]       a std_srvs/Trigger, or with a word std_srvs/SetBool, and its reply
  levels NODE NAME...             rcl_interfaces/GetLoggerLevels of loggers, and its reply
  level NODE NAME LEVEL           rcl_interfaces/SetLoggerLevels of one logger, and its reply
  target FRAME X Y Z              one message on /target, once somebody reads there
  twist TOPIC X Y Z SECONDS       TwistStamped in world at 50 Hz
  trajectory TOPIC SECONDS Q...   one JointTrajectory of joints joint_1, joint_2, ...
  velocities TOPIC SECONDS Q...   Float64MultiArray at 50 Hz
  endpoints                       what discovery says of every writer and reader
"""
import json
import sys
import threading
import time
from dataclasses import asdict

import ros2_types as ros
from cyclonedds.builtin import (BuiltinDataReader, BuiltinTopicDcpsPublication,
                                BuiltinTopicDcpsSubscription)

node = ros.Node()
readers = []
clients = {}
mutex = threading.Lock()


def say(**what):
    with mutex:
        print(json.dumps(what), flush=True)


def plain(value):
    """Arrays of bytes are long: their number and sum stand for them."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, (bytes, bytearray)) or (
            isinstance(value, list) and len(value) > 1000):
        return {'length': len(value), 'sum': sum(value)}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    if isinstance(value, float) and value != value:
        return 'nan'
    return value


def poll():
    while True:
        for topic, reader in list(readers):
            for message in reader.take(100):
                if type(message).__name__ != 'InvalidSample':  # A writer has left.
                    say(topic=topic, message=plain(asdict(message)))
        time.sleep(0.005)


def stamp():
    now = time.time_ns()
    return ros.Time(now // 10**9, now % 10**9)


def wait(ready, seconds=10.0):
    end = time.monotonic() + seconds
    while not ready() and time.monotonic() < end:
        time.sleep(0.02)
    return ready()


def ask(service, kinds, **fields):
    if service not in clients:
        clients[service] = node.client(service, *kinds)
    client = clients[service]
    if not wait(client.matched):
        raise LookupError('nobody offers %s' % service)
    return client.call(**fields)


def call(service, word=None):
    kinds = (ros.SetBoolRequest, ros.SetBoolResponse) if word else (
        ros.TriggerRequest, ros.TriggerResponse)
    reply = ask(service, kinds, **({'data': word == 'true'} if word else {}))
    say(service=service, success=reply.success, message=reply.message)


def levels(name, *loggers):
    service = name + '/get_logger_levels'
    reply = ask(service, (ros.GetLoggerLevelsRequest, ros.GetLoggerLevelsResponse),
                names=list(loggers))
    say(service=service, levels=[[level.name, level.level] for level in reply.levels])


def level(name, logger, number):
    service = name + '/set_logger_levels'
    reply = ask(service, (ros.SetLoggerLevelsRequest, ros.SetLoggerLevelsResponse),
                levels=[ros.LoggerLevel(logger, int(number))])
    say(service=service, results=[[done.successful, done.reason] for done in reply.results])


def streamed(writer, message, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if hasattr(message, 'header'):
            message.header.stamp = stamp()
        writer.write(message)
        time.sleep(0.02)


def once(writer, message):
    """Written when somebody reads, and has had time to know this writer, too; kept until acknowledged."""
    heard = wait(writer.get_matched_subscriptions)
    time.sleep(0.5)
    if hasattr(message, 'header'):
        message.header.stamp = stamp()
    writer.write(message)
    kept.append(writer)
    say(sent=bool(heard))


def endpoints():
    for kind, topic in (('writer', BuiltinTopicDcpsPublication),
                        ('reader', BuiltinTopicDcpsSubscription)):
        known = BuiltinDataReader(node.participant, topic)
        time.sleep(0.5)
        for endpoint in known.take(1000):
            if not hasattr(endpoint, 'topic_name'):
                continue
            policies = [repr(policy) for policy in endpoint.qos]
            say(endpoint=kind, name=endpoint.topic_name, type=endpoint.type_name,
                reliable=any('Reliable' in text for text in policies),
                latched=any('TransientLocal' in text for text in policies),
                own=str(endpoint.participant_key) == str(node.participant.guid))
    say(endpoint='end')


kept = []
threading.Thread(target=poll, daemon=True).start()
say(ready=True)
for line in sys.stdin:
    words = line.split()
    order, rest = words[0], words[1:]
    try:
        if order == 'read':
            reader = node.reader(rest[0], getattr(ros, rest[1]), reliable=rest[2] == 'reliable',
                                 latched=rest[3] == 'latched', depth=1000)
            readers.append((rest[0], reader))
        elif order == 'call':
            call(*rest)
        elif order == 'levels':
            levels(*rest)
        elif order == 'level':
            level(*rest)
        elif order == 'target':
            point = ros.Point(*[float(x) for x in rest[1:4]])
            once(node.writer('/target', ros.PointStamped),
                 ros.PointStamped(ros.Header(frame_id=rest[0]), point))
        elif order == 'twist':
            linear = ros.Vector3(*[float(x) for x in rest[1:4]])
            message = ros.TwistStamped(ros.Header(frame_id='world'), ros.Twist(linear))
            streamed(node.writer(rest[0], ros.TwistStamped), message, float(rest[4]))
        elif order == 'trajectory':
            joints = [float(q) for q in rest[2:]]
            names = ['joint_%d' % (i + 1) for i in range(len(joints))]
            seconds = float(rest[1])
            after = ros.Duration(int(seconds), int(seconds % 1 * 1e9))
            once(node.writer(rest[0], ros.JointTrajectory), ros.JointTrajectory(
                joint_names=names,
                points=[ros.JointTrajectoryPoint(positions=joints, time_from_start=after)]))
        elif order == 'velocities':
            message = ros.Float64MultiArray(data=[float(q) for q in rest[2:]])
            streamed(node.writer(rest[0], ros.Float64MultiArray), message, float(rest[1]))
        elif order == 'endpoints':
            endpoints()
    except Exception as error:  # The test reads it.
        say(error=repr(error))
