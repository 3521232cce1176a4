"""What one Python library decodes of a recording or a log: read_messages.py LIBRARY FILE, in that library's environment.

Prints an object of JSON: how many messages of each channel, or rows."""
import collections, contextlib, io, json, pathlib, subprocess, sys, tempfile


def mcap(file):
    """By the index; JSON is decoded, CDR is left as bytes."""
    from mcap.reader import SeekingReader

    counts = collections.Counter()
    with open(file, "rb") as stream:
        reader = SeekingReader(stream)
        # Without one it would read the file from its front, as others do not.
        assert reader.get_summary().chunk_indexes, "no index"
        for _, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                assert isinstance(json.loads(message.data), dict)
            counts[channel.topic] += 1
    return counts


def mcap_ros2_support(file):
    """Every message in CDR, decoded by the schemas of the file."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    counts = collections.Counter()
    with open(file, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        cdr = [c.topic for c in reader.get_summary().channels.values() if c.message_encoding == "cdr"]
        for _, channel, _, value in reader.iter_decoded_messages(topics=cdr):
            assert value.__slots__ or value.__dict__
            counts[channel.topic] += 1
    return counts


def rosbags(file):
    from rosbags.highlevel import AnyReader

    counts = collections.Counter()
    with AnyReader([pathlib.Path(file)]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
    return counts


def rerun(file):
    """Rows of each entity in what it converts the file to, by a component of the decoded message. Of a channel that it
    does not decode it keeps the bytes: told as such."""
    from rerun.chunk import RrdReader

    rows = collections.defaultdict(collections.Counter)
    with tempfile.TemporaryDirectory() as folder:
        out = f"{folder}/out.rrd"
        program = pathlib.Path(sys.executable).with_name("rerun")
        done = subprocess.run([program, "mcap", "convert", file, "-o", out], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        for chunk in RrdReader(out).stream().to_chunks():
            batch = chunk.to_record_batch()
            for name, column in zip(batch.schema.names, batch.columns):
                if ":" in name and not chunk.is_static:
                    rows[chunk.entity_path][name] += len(column) - column.null_count
    counts = {}
    for entity, components in rows.items():
        as_bytes = components.pop("McapMessage:data", 0)
        if components:
            # A cloud whose points it cannot read has a message and no points.
            is_cloud = any(name.startswith("sensor_msgs.msg.PointCloud2") for name in components)
            counts[entity] = components["Points3D:positions"] if is_cloud else max(components.values())
        elif as_bytes:
            counts[f"{entity} as bytes"] = as_bytes
    return counts


def pingverter(file):
    from pingverter.converter import cerul2pingmapper

    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        cerul2pingmapper(file, folder)
        tables = pathlib.Path(folder).rglob("*.csv")
        return {"rows": max(sum(1 for _ in open(table)) - 1 for table in tables)}


def brping(file):
    """Profiles of the OmniScan, message 2198, that the vendor's client takes out of the log."""
    from brping import PingParser

    parser, count = PingParser(), 0
    for byte in pathlib.Path(file).read_bytes():
        if parser.parse_byte(byte) == PingParser.NEW_MESSAGE:
            count += parser.rx_msg.message_id == 2198
    return {"rows": count}


if __name__ == "__main__":
    library, file = sys.argv[1:]
    print(json.dumps(globals()[library](file)))
