"""Writes an MCAP file anew, as tools do that compress, sort or filter: in chunks, with its own ids.

rewrite_mcap.py IN OUT [--compression none|lz4|zstd] [--chunk-bytes N] [--no-index]
                [--order stored|time|topic] [--from SECONDS] [--until SECONDS] [--without TOPIC]"""
import argparse

from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("input")
    parser.add_argument("output")
    parser.add_argument("--compression", default="zstd", choices=["none", "lz4", "zstd"])
    parser.add_argument("--chunk-bytes", type=int, default=1 << 20)
    parser.add_argument("--no-index", action="store_true")
    parser.add_argument("--order", default="stored", choices=["stored", "time", "topic"])
    parser.add_argument("--from", dest="first", type=float, default=0)
    parser.add_argument("--until", type=float, default=float("inf"))
    parser.add_argument("--without", action="append", default=[])
    asked = parser.parse_args()
    with open(asked.input, "rb") as stream:
        messages = list(make_reader(stream).iter_messages(log_time_order=asked.order == "time"))
    if asked.order == "topic":
        messages.sort(key=lambda found: found[1].topic)
    start = min(message.log_time for _, _, message in messages)
    with open(asked.output, "wb") as stream:
        writer = Writer(
            stream, chunk_size=asked.chunk_bytes, compression=CompressionType[asked.compression.upper()],
            index_types=IndexType.NONE if asked.no_index else IndexType.ALL, use_summary_offsets=not asked.no_index)
        writer.start()
        ids = {}
        for schema, channel, message in messages:
            at = (message.log_time - start) * 1e-9
            if channel.topic in asked.without or not asked.first <= at < asked.until:
                continue
            if channel.id not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            # As its users leave it out, messages are not numbered.
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()


if __name__ == "__main__":
    main()
