"""Makes the recorded sentences of the cockpit: dist/sentences.bin, one Ogg Opus file after the other, and
dist/sentences.json, which says where each begins and how long it is.

Outside the build, like everything in tools/: the files that it makes are committed. Needs
    pip install hibari-tts==0.2.1        (Apache-2.0; the voice comes with it)
and ffmpeg with libopus. The same versions give the same bytes.
"""

import json
import pathlib
import subprocess
import tempfile

import hibari

HERE = pathlib.Path(__file__).parent
SEED = 1
# A little slower than the voice's own pace: one hears it once, while driving.
SPEED = 0.95


def sentences():
    """Every sentence of sentences.txt; a test keeps that file to what the program says."""
    lines = (HERE / "sentences.txt").read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def encode(wav):
    """Ogg Opus, mono, without anything that changes from run to run."""
    command = [
        "ffmpeg", "-v", "error", "-i", str(wav), "-ac", "1", "-c:a", "libopus", "-b:a", "24k", "-vbr", "on",
        "-application", "voip", "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:a", "+bitexact",
        "-f", "ogg", "-",
    ]  # fmt: skip
    return subprocess.run(command, check=True, capture_output=True).stdout


def main():
    voice = hibari.Hibari()
    manifest, out = {}, bytearray()
    with tempfile.TemporaryDirectory() as directory:
        wav = pathlib.Path(directory) / "sentence.wav"
        for text in sentences():
            voice.save(text, str(wav), speed=SPEED, seed=SEED)
            clip = encode(wav)
            manifest[text] = [len(out), len(clip)]
            out += clip
    dist = HERE / "dist"
    dist.mkdir(exist_ok=True)
    (dist / "sentences.bin").write_bytes(out)
    text = json.dumps(manifest, ensure_ascii=False, indent=0, sort_keys=False)
    (dist / "sentences.json").write_text(text + "\n", encoding="utf-8")
    print(f"{len(manifest)} sentences, {len(out) / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
