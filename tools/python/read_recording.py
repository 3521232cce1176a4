"""Reads a recording and its log as other programs do.

read_recording.py A.mcap POSES [A.svlog PINGS]; the libraries are in requirements-readers.txt."""
import collections, contextlib, io, json, pathlib, subprocess, sys, tempfile

CDR = {"/sonar/raw": "data", "/pose": "pose", "/map/delta": "width", "/tf_static": "transforms"}
JSON = {"/sonar/link": "link", "/settings": "toml", "/events": None, "/status": None,
        "/map/delta_info": None}


def count_written(path):
    """Messages of each channel, record by record from the front: neither index nor statistics are asked."""
    from mcap.records import Channel, Message
    from mcap.stream_reader import StreamReader

    topics, counts = {}, collections.Counter()
    with open(path, "rb") as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                counts[topics[record.channel_id]] += 1
    return counts


def read_mcap(path):
    """Messages of each channel by the file's index, decoded by the schemas in the file."""
    from mcap.reader import SeekingReader
    from mcap_ros2.decoder import DecoderFactory

    found = collections.defaultdict(list)
    with open(path, "rb") as stream:
        reader = SeekingReader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_summary().chunk_indexes, "no index: it would be read from its front, as others do not"
        channels = reader.get_summary().channels.values()
        assert {c.topic for c in channels} == CDR.keys() | JSON.keys(), channels
        assert all(c.schema_id for c in channels), "a channel has no schema"
        for topic in CDR:
            for _, _, message, value in reader.iter_decoded_messages(topics=[topic]):
                assert hasattr(value, CDR[topic]), value
                found[topic].append(value)
        for topic, key in JSON.items():
            for _, _, message in reader.iter_messages(topics=[topic]):
                value = json.loads(message.data)
                assert isinstance(value, dict) and (key is None or key in value), value
                found[topic].append(value)
    return found


def read_rerun(path):
    """Messages of each channel in what Rerun converts the recording to: rows of a component of the decoded message. Of
    JSON it keeps the bytes."""
    from rerun.chunk import RrdReader

    rerun = pathlib.Path(sys.executable).with_name("rerun")
    rows = collections.defaultdict(collections.Counter)
    with tempfile.TemporaryDirectory() as folder:
        out = f"{folder}/out.rrd"
        done = subprocess.run([rerun, "mcap", "convert", path, "-o", out], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        for chunk in RrdReader(out).stream().to_chunks():
            batch = chunk.to_record_batch()
            for name, column in zip(batch.schema.names, batch.columns):
                is_component = ":" in name and not chunk.is_static
                if is_component and (name == "McapMessage:data") == (chunk.entity_path in JSON):
                    rows[chunk.entity_path][name] += len(column) - column.null_count
    return {topic: max(components.values()) for topic, components in rows.items()}


def read_pingverter(path):
    """Rows of pings that PINGVerter finds."""
    from pingverter import cerul

    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        log = cerul(svlog=path)
        log.tempC, log.metaDir = 1.0, folder
        log._getFileLen()
        log._parseFileHeader()
        log._locatePackets()
    return log.header_dat


def read_brping(path):
    """Profiles that the vendor's client takes out of the log."""
    from brping import PingParser, definitions

    parser, count = PingParser(), 0
    with open(path, "rb") as stream:
        for byte in stream.read():
            if parser.parse_byte(byte) == PingParser.NEW_MESSAGE:
                count += parser.rx_msg.message_id == 2198
    return count, parser.errors


def check_recording(path, poses):
    written = count_written(path)
    counts = {topic: len(values) for topic, values in read_mcap(path).items()}
    print("mcap:", counts)
    assert counts == written, (counts, written)
    assert counts["/pose"] == poses, counts
    assert counts["/settings"] == 1 and counts["/sonar/raw"] > 0, counts
    rows = read_rerun(path)
    decoded = {topic: rows.get(topic, 0) for topic in written}
    print("rerun:", decoded)
    assert decoded == written, (decoded, written)


def check_layout(found):
    """Every message path of the Foxglove layout leads to something."""
    layout = pathlib.Path(__file__).parent.with_name("foxglove") / "echosplat.json"
    panels = json.loads(layout.read_text())["configById"].values()
    asked = [path["value"] for panel in panels for path in panel.get("paths", [])]
    asked += [panel["topicPath"] for panel in panels if "topicPath" in panel]
    asked += [topic for panel in panels for topic in panel.get("topics", {})]
    for topic, *members in (path.split(".") for path in asked):
        assert topic in CDR.keys() | JSON.keys(), topic
        value = found[topic][-1] if members else None
        for member in members:
            assert member in value, (topic, members)
            value = value[member]
    print("layout:", len(asked), "paths")


def check_log(path, pings):
    rows = read_pingverter(path)
    print("pingverter:", len(rows), "pings")
    assert len(rows) == pings, (len(rows), pings)
    assert (rows["analog_gain"] > 1.0).all(), rows["analog_gain"]
    count, errors = read_brping(path)
    print("brping:", count, "pings,", errors, "errors")
    assert (count, errors) == (pings, 0), (count, errors)


def main():
    check_recording(sys.argv[1], int(sys.argv[2]))
    if len(sys.argv) > 3:
        check_layout(read_mcap(sys.argv[1]))
        check_log(sys.argv[3], int(sys.argv[4]))
    print("all read")


if __name__ == "__main__":
    main()
