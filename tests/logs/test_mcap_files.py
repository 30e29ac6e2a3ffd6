"""Bags, written by the library that ROS 2 users write them with."""

import io
import json

import numpy as np
import pytest
from mcap.writer import Writer as JsonWriter
from mcap_ros2.writer import Writer

from adr_service.errors import InvalidInput
from adr_service.logs import mcap_files
from adr_service.logs.base import Clock
from adr_service.logs.catalogue import read_logs
from adr_service.logs.mcap_files import read_mcap

JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
COMMANDS = "float64[] data\n"
CLOCK = Clock()  # topics have their own


def bag(stamps=lambda i: 1_700_000_000 + 0.002 * i):
    """Half a second of joint states, in another order every second time, and of commands."""
    buffer = io.BytesIO()
    writer = Writer(buffer)
    states = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
    commands = writer.register_msgdef("std_msgs/msg/Float64MultiArray", COMMANDS)
    for i in range(250):
        seconds, nanoseconds = int(stamps(i)), round(1e9 * (stamps(i) % 1))
        stamp = {"sec": seconds, "nanosec": nanoseconds}
        names = ["shoulder", "elbow"] if i % 2 == 0 else ["elbow", "shoulder"]
        values = [0.01 * i, -0.01 * i] if i % 2 == 0 else [-0.01 * i, 0.01 * i]
        header = {"stamp": stamp, "frame_id": ""}
        message = {
            "header": header,
            "name": names,
            "position": values,
            "velocity": [],
            "effort": [],
        }
        arrived = 1_700_000_000 * 10**9 + 2_000_000 * i + 5_000_000  # five milliseconds later
        writer.write_message("/joint_states", states, message, arrived)
        if i % 10 == 0:
            writer.write_message("/command", commands, {"data": [0.1 * i]}, arrived)
    writer.finish()
    return buffer.getvalue()


def test_joint_states_become_columns_by_joint_at_their_own_stamps():
    log = read_mcap("run.mcap", bag())
    assert set(log.names) == {
        "/joint_states.position.shoulder",
        "/joint_states.position.elbow",
        "/command.data_0",
    }
    signal = log.signal("/joint_states.position.shoulder", CLOCK)
    np.testing.assert_allclose(signal.value, 0.01 * np.arange(250))
    np.testing.assert_allclose(signal.time - 1.7e9, 0.002 * np.arange(250), atol=1e-6)


def test_a_message_without_a_header_counts_from_its_arrival():
    log = read_mcap("run.mcap", bag())
    signal = log.signal("/command.data_0", CLOCK)
    np.testing.assert_allclose(signal.time - 1.7e9, 0.02 * np.arange(25) + 0.005, atol=1e-6)
    assert signal.has_arrivals
    assert not log.signal("/joint_states.position.elbow", CLOCK).has_arrivals


def test_messages_in_json_are_read_and_those_in_unknown_encodings_listed():
    buffer = io.BytesIO()
    writer = JsonWriter(buffer)
    writer.start()
    schema = writer.register_schema("State", "jsonschema", b"{}")
    known = writer.register_channel("/state", "json", schema)
    unknown = writer.register_channel("/secret", "mystery", schema)
    for i in range(3):
        content = json.dumps({"arm": {"q": i, "on": True}, "mode": "auto"}).encode()
        writer.add_message(known, i * 10**9, content, i * 10**9)
        writer.add_message(unknown, i * 10**9, b"?", i * 10**9)
    writer.finish()
    log = read_mcap("run.mcap", buffer.getvalue())
    assert sorted(log.names) == ["/state.arm.on", "/state.arm.q"]
    assert log.unread == {
        "/secret": "its messages are in 'mystery', by a schema in 'jsonschema'; accepted are those "
        "of 'ros2msg', and JSON"
    }


def json_bag(*messages):
    """One message of JSON a second on /state, from second 5 on."""
    buffer = io.BytesIO()
    writer = JsonWriter(buffer)
    writer.start()
    channel = writer.register_channel(
        "/state", "json", writer.register_schema("State", "jsonschema", b"{}")
    )
    for i, message in enumerate(messages):
        writer.add_message(channel, (5 + i) * 10**9, json.dumps(message).encode(), 5 * 10**9)
    writer.finish()
    return buffer.getvalue()


def test_fields_of_a_list_of_messages_are_columns_of_their_place():
    motors = [{"q": 1.0, "tau": 2.0}, {"q": 3.0, "tau": 4.0}]
    (stream,) = read_mcap("run.mcap", json_bag({"motors": motors}, {"motors": motors})).streams
    assert {name: values[0] for name, values in stream.columns.items()} == {
        "/state.motors_0.q": 1,
        "/state.motors_0.tau": 2,
        "/state.motors_1.q": 3,
        "/state.motors_1.tau": 4,
    }


def test_a_message_that_cannot_be_read_leaves_the_others_of_its_topic():
    good = [{"header": {"stamp": {"sec": 1 + i, "nanosec": 0}}, "q": i} for i in range(2)]
    log = read_mcap("run.mcap", json_bag(*good, {"header": {"stamp": {"t": 3}}, "q": 2}))
    np.testing.assert_array_equal(log.streams[0].columns["/state.q"], [0, 1])
    assert list(log.unread) == ["/state"]


def test_a_topic_with_too_many_columns_is_listed_and_others_are_read(monkeypatch):
    monkeypatch.setattr(mcap_files, "_WIDEST", 10)
    log = read_mcap("run.mcap", json_bag({"markers": [{"x": 1, "y": 2}] * 6}, {"markers": []}))
    assert (log.streams, log.unread) == ((), {"/state": "it has more than 10 columns"})


@pytest.mark.parametrize(
    ("whole", "rest"), [("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs")]
)
def test_stamps_of_other_systems_are_read(whole, rest):
    stamps = [{whole: 1, rest: 0}, {whole: 1, rest: 500_000_000}, {whole: 0, rest: 0}]
    messages = [{"header": {"stamp": stamp}, "q": 1} for stamp in stamps[:2]]
    (stream,) = read_mcap("run.mcap", json_bag(*messages)).streams
    np.testing.assert_allclose(stream.stamps, [1, 1.5])
    never_set = json_bag({"header": {"stamp": stamps[2]}, "q": 1})
    assert read_mcap("run.mcap", never_set).streams[0].stamps == [5]


def test_stamps_before_a_clock_was_set_are_no_times():
    """A node with simulated time stamps zero until the first message of the clock."""
    stamps = [{"sec": sec, "nanosec": 0} for sec in (0, 0, 12, 13)]
    messages = [{"header": {"stamp": stamp}, "q": i} for i, stamp in enumerate(stamps)]
    (stream,) = read_mcap("run.mcap", json_bag(*messages)).streams
    known = np.isfinite(stream.stamps)
    np.testing.assert_array_equal(stream.stamps[known], [12, 13])
    np.testing.assert_array_equal(stream.columns["/state.q"][known], [2, 3])


def test_a_topic_with_stamps_that_cannot_be_read_is_listed():
    log = read_mcap("run.mcap", json_bag({"header": {"stamp": "noon"}, "q": 1}))
    assert log.unread == {"/state": "its header.stamp has no sec and nanosec"}


def test_a_bag_whose_stamps_begin_again_is_refused():
    """Sorting would mix the two passes."""
    log = read_mcap("run.mcap", bag(stamps=lambda i: 1_700_000_000 + 2 * (i < 125) + 0.002 * i))
    with pytest.raises(InvalidInput, match="goes back by"):
        log.signal("/joint_states.position.shoulder", CLOCK)


@pytest.mark.parametrize("back", [0.5, 0.5017])
def test_a_clock_that_was_set_back_is_refused(back):
    """By less than the second that a message may be late. Sorting would mix the two stretches."""
    log = read_mcap("run.mcap", bag(stamps=lambda i: 1_700_000_000 - back * (i > 120) + 0.02 * i))
    with pytest.raises(InvalidInput, match="goes back by"):
        log.signal("/joint_states.position.shoulder", CLOCK)


@pytest.mark.parametrize("count", [1, 3])
def test_messages_that_are_late_are_put_where_they_belong(count):
    """Two messages come in the wrong order, or four."""
    late = dict(zip(range(100, 100 + count), range(100 + count, 100, -1), strict=True))
    order = [late.get(i, i) for i in range(250)]
    order[100 + count] = 100
    log = read_mcap("run.mcap", bag(stamps=lambda i: 1_700_000_000 + 0.02 * order[i]))
    signal = log.signal("/joint_states.position.shoulder", CLOCK)
    assert np.all(np.diff(signal.time) > 0)
    assert signal.value[order[100]] == pytest.approx(1.0)


def test_one_stamp_that_is_far_ahead_is_put_where_it_belongs():
    log = read_mcap("run.mcap", bag(stamps=lambda i: 1_700_000_000 + 0.02 * (i + 10 * (i == 100))))
    signal = log.signal("/joint_states.position.shoulder", CLOCK)
    assert np.all(np.diff(signal.time) > 0)
    assert 1.0 in signal.value[105:115].round(6)


def test_places_with_one_name_are_numbered():
    """Two robots whose drivers publish to one topic."""
    twice = {"name": ["a", "a"], "position": [1.0, 2.0]}
    log = read_mcap("run.mcap", json_bag(twice))
    assert log.names == ["/state.position_0", "/state.position_1"]


@pytest.mark.parametrize("end", [0, -1000])
def test_a_bag_of_a_recorder_that_was_killed_says_so(end):
    with pytest.raises(InvalidInput, match="it is cut short, as by a recorder that was killed"):
        read_mcap("run.mcap", bag()[:end])


def test_a_bag_that_unpacks_to_too_much_is_refused(monkeypatch):
    monkeypatch.setattr(mcap_files, "MOST_BYTES", 10_000)
    with pytest.raises(InvalidInput, match="unpacks to more than 10,000 bytes"):
        read_mcap("run.mcap", bag())


@pytest.mark.parametrize("end", [0, 8, 100, 2000])
def test_a_damaged_bag_is_refused(end):
    with pytest.raises(InvalidInput, match=r"run\.mcap is no bag that can be read"):
        read_mcap("run.mcap", bag()[:end])


def test_a_bag_with_a_wrong_checksum_is_refused():
    whole = bytearray(bag())
    whole[1500] ^= 255
    with pytest.raises(InvalidInput, match=r"run\.mcap is no bag that can be read"):
        read_mcap("run.mcap", bytes(whole))


def test_the_bags_in_a_folder_are_recordings_in_natural_order(tmp_path):
    for number in (10, 2):
        (tmp_path / f"run_{number}.mcap").write_bytes(bag())
    assert [log.source for log in read_logs(tmp_path)] == ["run_2.mcap", "run_10.mcap"]


def split_bag(folder, *parts):
    """The folder of a ROS 2 bag whose parts hold messages (topic, second, value)."""
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    for number, messages in enumerate(parts):
        buffer = io.BytesIO()
        writer = JsonWriter(buffer)
        writer.start()
        schema = writer.register_schema("Value", "jsonschema", b"{}")
        channels = {}
        for topic, second, value in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            arrived, content = second * 10**9, json.dumps({"value": value}).encode()
            writer.add_message(channels[topic], arrived, content, arrived)
        writer.finish()
        (folder / f"run_{number}.mcap").write_bytes(buffer.getvalue())
    return folder


def test_the_parts_of_a_split_bag_are_one_recording_in_natural_order(tmp_path):
    """Channels have other numbers in the first part, which has the only command."""
    first = [("/command", 1, 0.5), ("/state", 1, 0.0)]
    later = [[("/state", second, float(second))] for second in range(2, 13)]
    (log,) = read_logs(split_bag(tmp_path / "run", first, *later))
    assert log.source == "run"
    assert set(log.names) == {"/command.value", "/state.value"}
    np.testing.assert_array_equal(log.commands("/command.value", CLOCK).time, [1])
    signal = log.signal("/state.value", CLOCK)
    np.testing.assert_array_equal(signal.time, np.arange(1, 13))
    np.testing.assert_array_equal(signal.value, [0, *range(2, 13)])


def test_the_damaged_part_of_a_split_bag_is_named(tmp_path):
    folder = split_bag(tmp_path / "run", [("/state", 1, 0.0)], [("/state", 2, 0.0)])
    (folder / "run_1.mcap").write_bytes(b"damaged")
    with pytest.raises(InvalidInput, match=r"^run_1\.mcap is no bag that can be read"):
        read_logs(folder)


def test_lists_that_are_too_long_and_fields_that_are_too_deep_are_listed_and_others_read():
    deep = {"q": 1.0}
    for _ in range(mcap_files._DEEPEST + 1):
        deep = {"a": deep}
    message = {"scan": list(range(300)), "fits": list(range(256)), "deep": deep, "q": 2.0}
    log = read_mcap("run.mcap", json_bag(message, message))
    assert set(log.names) == {"/state.q", *(f"/state.fits_{i}" for i in range(256))}
    assert log.unread == {
        "/state.scan": "it is a list of 300 places; accepted are 256",
        f"/state.deep{'.a' * 6}": "it is nested more than 6 fields deep",
    }
    with pytest.raises(
        InvalidInput, match=r"'/state\.scan' cannot be read: it is a list of 300 places"
    ):
        log.signal("/state.scan_280", CLOCK)


def test_bytes_are_numbers_and_lists_within_lists_are_listed():
    buffer = io.BytesIO()
    writer = Writer(buffer)
    raw = writer.register_msgdef("test/msg/Raw", "uint8[] data\n")
    for i in range(2):
        writer.write_message("/gripper", raw, {"data": [7, 200 + i]}, i * 10**9)
    writer.finish()
    log = read_mcap("run.mcap", buffer.getvalue())
    np.testing.assert_array_equal(log.streams[0].columns["/gripper.data_1"], [200, 201])
    message = {"q": [[0.1, 0.2]], "u": 1.0}
    nested = read_mcap("run.mcap", json_bag(message, message))
    assert nested.unread == {"/state.q": "it is a list of lists"}
    with pytest.raises(InvalidInput, match=r"'/state\.q' cannot be read: it is a list of lists"):
        nested.signal("/state.q_0", CLOCK)


def test_an_image_is_listed_as_a_list_that_is_too_long():
    buffer = io.BytesIO()
    writer = Writer(buffer)
    image = writer.register_msgdef("test/msg/Image", "float32[] data\nfloat32 exposure\n")
    for i in range(2):
        writer.write_message("/image", image, {"data": [0.0] * 10_000, "exposure": i}, i * 10**9)
    writer.finish()
    log = read_mcap("run.mcap", buffer.getvalue())
    assert log.names == ["/image.exposure"]
    assert log.unread == {"/image.data": "it is a list of 10,000 places; accepted are 256"}
