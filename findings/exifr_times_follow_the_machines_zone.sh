#!/usr/bin/env bash
# exifr: the time of a photograph depends on where the computer stands, and parts of a second go.
#
# EXIF keeps the camera's local time as text, its distance from UTC in OffsetTimeOriginal and parts
# of the second in SubSecTimeOriginal. exifr turns the text into a JavaScript `Date`, an instant of
# UTC, by the zone of the machine that reads it, though it reads the other two and hands them out
# beside it. One file gives instants that are seven hours apart on two computers, and 0.75 s are
# dropped.
# It matters to who joins photographs to a track or to events of a receiver in a web application:
# right at the developer's desk, hours off on a server. Set `reviveValues: false`, and put text,
# fraction and offset together.
# Seen on 2026-12-01 with exifr 7.1.3, taken at 10:00:00.75 +02:00, that is 08:00:00.75 UTC: "in
# UTC: 2026-06-01T10:00:00.000Z", "in Europe/Berlin: 2026-06-01T08:00:00.000Z", "in America/Lima:
# 2026-06-01T15:00:00.000Z".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm init -y >/dev/null
npm install --silent --ignore-scripts exifr@7.1.3 >/dev/null
cat > time.mjs <<'JS'
import exifr from 'exifr';

const ascii = (text) => Buffer.from(`${text}\0`, 'latin1');
const fields = [[0x9003, ascii('2026:06:01 10:00:00')], [0x9011, ascii('+02:00')], [0x9291, ascii('750')]];
const entry = (tag, type, count, value) => {
  const bytes = Buffer.alloc(12);
  bytes.writeUInt16LE(tag, 0);
  bytes.writeUInt16LE(type, 2);
  bytes.writeUInt32LE(count, 4);
  if (Buffer.isBuffer(value)) value.copy(bytes, 8);
  else bytes.writeUInt32LE(value, 8);
  return bytes;
};
const directory = (entries) => Buffer.concat([Buffer.from([entries.length, 0]), ...entries, Buffer.alloc(4)]);
const [first, second] = [8, 8 + 2 + 12 + 4];
let at = second + 2 + 12 * fields.length + 4;
const entries = [];
const tail = [];
for (const [tag, text] of fields) {
  entries.push(entry(tag, 2, text.length, text.length > 4 ? at : text));
  if (text.length > 4) {
    tail.push(text);
    at += text.length;
  }
}
const head = Buffer.from([0x49, 0x49, 42, 0, first, 0, 0, 0]);
const tiff = Buffer.concat([head, directory([entry(0x8769, 4, 1, second)]), directory(entries), ...tail]);
const times = await exifr.parse(tiff);
const plain = await exifr.parse(tiff, { reviveValues: false });
const texts = [plain.DateTimeOriginal, times.OffsetTimeOriginal, times.SubSecTimeOriginal].join(' ');
console.log(`${times.DateTimeOriginal.toISOString()} (read: ${texts})`);
JS
expect() {
    seen=$(TZ="$1" node time.mjs)
    echo "in $1: $seen"
    [ "$seen" = "$2 (read: 2026:06:01 10:00:00 +02:00 750)" ]
}
echo "exifr $(node -p "require('./node_modules/exifr/package.json').version")"
expect UTC 2026-06-01T10:00:00.000Z
expect Europe/Berlin 2026-06-01T08:00:00.000Z
expect America/Lima 2026-06-01T15:00:00.000Z
