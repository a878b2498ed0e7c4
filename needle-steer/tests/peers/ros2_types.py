"""ROS 2's messages for Cyclone DDS, written from ROS 2's interface definitions, and how ROS 2 names
topics, types and services in DDS (design.ros2.org, "Topic and Service name mapping to DDS").

Cyclone DDS is a DDS implementation of another project. Its own types and its own encoder are at work
here; nothing of this project is.
"""
import os
from dataclasses import dataclass, field

# Before cyclonedds is imported: on the loopback interface alone, which has no multicast. Participants
# look for each other at the ports of the domain.
os.environ['CYCLONEDDS_URI'] = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    '<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto'
    '</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers>'
    '<Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>')

from cyclonedds.core import Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.idl.annotations import final  # noqa: E402
from cyclonedds.idl.types import array, float64, int32, int64, sequence, uint8, uint32, uint64  # noqa: E402
from cyclonedds.pub import DataWriter, Publisher  # noqa: E402
from cyclonedds.sub import DataReader, Subscriber  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402


def ros(package, kind='msg', suffix=''):
    """A struct under the type name that ROS 2 gives it."""
    def name(cls):
        return '%s::%s::dds_::%s%s_' % (package, kind, cls.__name__, suffix)

    def make(cls):
        meta = type(IdlStruct)
        body = meta.__prepare__(cls.__name__, (IdlStruct,), typename=name(cls))
        for key, value in cls.__dict__.items():
            if key not in ('__dict__', '__weakref__'):
                body[key] = value
        made = meta(cls.__name__, (IdlStruct,), body, typename=name(cls))
        return final(dataclass(made))
    return make


@ros('builtin_interfaces')
class Time:
    sec: int32 = 0
    nanosec: uint32 = 0


@ros('std_msgs')
class Header:
    stamp: Time = field(default_factory=Time)
    frame_id: str = ''


@ros('std_msgs')
class String:
    data: str = ''


@ros('std_msgs')
class MultiArrayDimension:
    label: str = ''
    size: uint32 = 0
    stride: uint32 = 0


@ros('std_msgs')
class MultiArrayLayout:
    dim: sequence[MultiArrayDimension] = field(default_factory=list)
    data_offset: uint32 = 0


@ros('std_msgs')
class Float64MultiArray:
    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: sequence[float64] = field(default_factory=list)


@ros('geometry_msgs')
class Point:
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@ros('geometry_msgs')
class Vector3:
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@ros('geometry_msgs')
class Quaternion:
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@ros('geometry_msgs')
class PointStamped:
    header: Header = field(default_factory=Header)
    point: Point = field(default_factory=Point)


@ros('geometry_msgs')
class Twist:
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@ros('geometry_msgs')
class TwistStamped:
    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@ros('geometry_msgs')
class Transform:
    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@ros('geometry_msgs')
class TransformStamped:
    header: Header = field(default_factory=Header)
    child_frame_id: str = ''
    transform: Transform = field(default_factory=Transform)


@ros('tf2_msgs')
class TFMessage:
    transforms: sequence[TransformStamped] = field(default_factory=list)


@ros('sensor_msgs')
class JointState:
    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@ros('sensor_msgs')
class Image:
    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    encoding: str = ''
    is_bigendian: uint8 = 0
    step: uint32 = 0
    data: sequence[uint8] = field(default_factory=list)


@ros('sensor_msgs')
class RegionOfInterest:
    x_offset: uint32 = 0
    y_offset: uint32 = 0
    height: uint32 = 0
    width: uint32 = 0
    do_rectify: bool = False


@ros('sensor_msgs')
class CameraInfo:
    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    distortion_model: str = ''
    d: sequence[float64] = field(default_factory=list)
    k: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)
    r: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)
    p: array[float64, 12] = field(default_factory=lambda: [0.0] * 12)
    binning_x: uint32 = 0
    binning_y: uint32 = 0
    roi: RegionOfInterest = field(default_factory=RegionOfInterest)


@ros('builtin_interfaces')
class Duration:
    sec: int32 = 0
    nanosec: uint32 = 0


@ros('trajectory_msgs')
class JointTrajectoryPoint:
    positions: sequence[float64] = field(default_factory=list)
    velocities: sequence[float64] = field(default_factory=list)
    accelerations: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@ros('trajectory_msgs')
class JointTrajectory:
    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    points: sequence[JointTrajectoryPoint] = field(default_factory=list)


@ros('rcl_interfaces')
class Log:
    stamp: Time = field(default_factory=Time)
    level: uint8 = 0
    name: str = ''
    msg: str = ''
    file: str = ''
    function: str = ''
    line: uint32 = 0


@ros('needle_steer_msgs')
class State:
    header: Header = field(default_factory=Header)
    step: uint64 = 0
    phase: str = ''
    mode: str = ''
    tracking: str = ''
    arm: str = ''
    lateral_error: float64 = 0.0
    axial_distance: float64 = 0.0
    depth: float64 = 0.0
    predicted_miss: float64 = 0.0
    stiffness: float64 = 0.0
    mean_stretch: float64 = 0.0
    max_stretch: float64 = 0.0
    entry_force: float64 = 0.0


@ros('needle_steer_msgs')
class SensedPoint:
    position: Point = field(default_factory=Point)
    sigma: float64 = 0.0


@ros('needle_steer_msgs')
class SensedTip:
    position: Point = field(default_factory=Point)
    covariance: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)
    direction: Vector3 = field(default_factory=Vector3)
    direction_sigma: float64 = 0.0


# A field of the shape is called as the type of a list is.
Points = sequence[SensedPoint]


@ros('needle_steer_msgs')
class Shape:
    header: Header = field(default_factory=Header)
    sequence: uint64 = 0
    points: Points = field(default_factory=list)
    tip: SensedTip = field(default_factory=SensedTip)


# What `rmw_cyclonedds_cpp` sends for a service: a client's number and a request's before the message.
@ros('std_srvs', 'srv', '_Request')
class Trigger:
    guid: uint64 = 0
    seq: int64 = 0
    structure_needs_at_least_one_member: uint8 = 0


TriggerRequest = Trigger


@ros('std_srvs', 'srv', '_Response')
class Trigger:  # noqa: F811
    guid: uint64 = 0
    seq: int64 = 0
    success: bool = False
    message: str = ''


TriggerResponse = Trigger


@ros('std_srvs', 'srv', '_Request')
class SetBool:
    guid: uint64 = 0
    seq: int64 = 0
    data: bool = False


SetBoolRequest = SetBool


@ros('std_srvs', 'srv', '_Response')
class SetBool:  # noqa: F811
    guid: uint64 = 0
    seq: int64 = 0
    success: bool = False
    message: str = ''


SetBoolResponse = SetBool


@ros('rcl_interfaces')
class LoggerLevel:
    name: str = ''
    level: uint32 = 0


@ros('rcl_interfaces')
class SetLoggerLevelsResult:
    successful: bool = False
    reason: str = ''


@ros('rcl_interfaces', 'srv', '_Request')
class GetLoggerLevels:
    guid: uint64 = 0
    seq: int64 = 0
    names: sequence[str] = field(default_factory=list)


GetLoggerLevelsRequest = GetLoggerLevels


@ros('rcl_interfaces', 'srv', '_Response')
class GetLoggerLevels:  # noqa: F811
    guid: uint64 = 0
    seq: int64 = 0
    levels: sequence[LoggerLevel] = field(default_factory=list)


GetLoggerLevelsResponse = GetLoggerLevels


@ros('rcl_interfaces', 'srv', '_Request')
class SetLoggerLevels:
    guid: uint64 = 0
    seq: int64 = 0
    levels: sequence[LoggerLevel] = field(default_factory=list)


SetLoggerLevelsRequest = SetLoggerLevels


@ros('rcl_interfaces', 'srv', '_Response')
class SetLoggerLevels:  # noqa: F811
    guid: uint64 = 0
    seq: int64 = 0
    results: sequence[SetLoggerLevelsResult] = field(default_factory=list)


SetLoggerLevelsResponse = SetLoggerLevels


RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
CDR = Policy.DataRepresentation(use_cdrv0_representation=True)


def quality(reliable=True, latched=False, depth=10):
    """As ROS 2's profiles have it."""
    return Qos(RELIABLE if reliable else Policy.Reliability.BestEffort,
               Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
               Policy.History.KeepLast(depth), CDR)


class Node:
    """A participant of the domain that ROS_DOMAIN_ID names."""

    def __init__(self):
        self.participant = DomainParticipant(int(os.environ['ROS_DOMAIN_ID']))
        self.publisher = Publisher(self.participant)
        self.subscriber = Subscriber(self.participant)

    def reader(self, topic, kind, **qos):
        topic = Topic(self.participant, 'rt' + topic, kind)
        return DataReader(self.subscriber, topic, quality(**qos))

    def writer(self, topic, kind, **qos):
        topic = Topic(self.participant, 'rt' + topic, kind)
        return DataWriter(self.publisher, topic, quality(**qos))

    def client(self, service, request, response):
        return Client(self, service, request, response)


class Client:
    """A service's client, as `rmw_cyclonedds_cpp` makes one."""

    def __init__(self, node, service, request, response):
        asked = Topic(node.participant, 'rq%sRequest' % service, request)
        heard = Topic(node.participant, 'rr%sReply' % service, response)
        self.writer = DataWriter(node.publisher, asked, quality())
        self.reader = DataReader(node.subscriber, heard, quality())
        self.request = request
        self.guid = int.from_bytes(os.urandom(8), 'little')
        self.seq = 0

    def matched(self):
        return self.writer.get_matched_subscriptions() and self.reader.get_matched_publications()

    def call(self, **fields):
        """The reply with this client's number and the request's; other clients' are passed over."""
        self.seq += 1
        self.writer.write(self.request(guid=self.guid, seq=self.seq, **fields))
        for reply in self.reader.take_iter(timeout=duration(seconds=5)):
            if (reply.guid, reply.seq) == (self.guid, self.seq):
                return reply
        raise TimeoutError('no reply')
