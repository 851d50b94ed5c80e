// Reads MCAP files with Foxglove's own packages and prints what they found, one JSON value a line:
// a file's header, schemas, metadata and attachments, then every message.
//
//   node decode.mjs indexed|streamed FILE...
import zstd from '@foxglove/wasm-zstd';
import { parse } from '@foxglove/rosmsg';
import { MessageReader } from '@foxglove/rosmsg2-serialization';
import { McapIndexedReader, McapStreamReader } from '@mcap/core';
import { open, readFile } from 'node:fs/promises';

const decompressHandlers = { zstd: (data, size) => zstd.decompress(data, Number(size)) };

// JSON has no maps, typed arrays, NaN or infinities, and JavaScript reads its large integers as floats.
function plain(key, value) {
  if (typeof value === 'bigint') return { $: `${value}` };
  if (typeof value === 'number' && !Number.isFinite(value)) return { $: `${value}` };
  if (value instanceof Map) return Object.fromEntries(value);
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
}

const lines = [];
function print(kind, value) {
  lines.push(JSON.stringify({ kind, ...value }, plain));
}

// Decodes the messages of one file.
class Decoder {
  schemas = new Map();
  channels = new Map();

  schema({ id, name, encoding, data }) {
    if (this.schemas.has(id)) return;
    try {
      const definitions = parse(new TextDecoder().decode(data), { ros2: true });
      this.schemas.set(id, { name, reader: new MessageReader(definitions) });
      print('schema', { name, encoding, definitions });
    } catch (error) {
      this.schemas.set(id, { name, reader: undefined });
      print('schema', { name, encoding, error: `${error}` });
    }
  }

  channel(channel) {
    this.channels.set(channel.id, channel);
  }

  message({ channelId, logTime, publishTime, sequence, data }) {
    const { topic, schemaId } = this.channels.get(channelId);
    const { name, reader } = this.schemas.get(schemaId);
    const found = { topic, type: name, logTime, publishTime, sequence };
    try {
      found.value = reader.readMessage(data);
      found.trailing = data.byteLength - reader.lastReadByteLength();
    } catch (error) {
      found.error = `${error}`;
    }
    print('message', found);
  }
}

// By the index at the end of the file, in order of log time.
async function indexed(path) {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, size) =>
      (await file.read(new Uint8Array(Number(size)), 0, Number(size), Number(offset))).buffer,
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const decoder = new Decoder();
  print('header', reader.header);
  print('statistics', reader.statistics);
  reader.schemasById.forEach((schema) => decoder.schema(schema));
  reader.channelsById.forEach((channel) => decoder.channel(channel));
  for await (const record of reader.readMetadata()) print('metadata', record);
  for await (const record of reader.readAttachments()) print('attachment', record);
  for await (const record of reader.readMessages()) decoder.message(record);
  await file.close();
}

// From the first byte to the last, as the records stand in the file.
async function streamed(path) {
  const reader = new McapStreamReader({ decompressHandlers });
  const decoder = new Decoder();
  const take = {
    Header: (record) => print('header', record),
    Statistics: (record) => print('statistics', record),
    Metadata: (record) => print('metadata', record),
    Attachment: (record) => print('attachment', record),
    Schema: (record) => decoder.schema(record),
    Channel: (record) => decoder.channel(record),
    Message: (record) => decoder.message(record),
  };
  reader.append(await readFile(path));
  for (let record; (record = reader.nextRecord()); ) take[record.type]?.(record);
  if (!reader.done()) throw new Error(`${path} does not end as an MCAP file`);
}

await zstd.isLoaded;
const [how, ...paths] = process.argv.slice(2);
for (const path of paths) await { indexed, streamed }[how](path);
process.stdout.write(lines.join('\n') + '\n');
