"""A run that is chosen, begun and watched by requests of a page: one session for all its browsers.

ask       what a path is, what a run of it takes: the application's process answers
folder    what lies in a folder of this machine
begin     the command of a choice, made here of the choice anew: a page names no command
watch     a run, its stages and loss; stop and resume it
"""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from shlex import join
from typing import Any

from radiant_core.errors import BadInput, RadiantError
from radiant_viewer.runs.progress_summary import progress_summary
from radiant_viewer.runs.run_feeds import Begun, RunFeeds
from radiant_viewer.runs.run_view import is_planned
from radiant_viewer.start.choices import ListedMachines, result_path
from radiant_viewer.start.start_feeds import StartFeeds

ASKED = ("look", "forecast", "machines", "profiles")
MAX_NAMES = 500
"""Of a folder's folders, and of its files, so many are listed."""
END_S = 2.0


class StartSession:
    """Requests come from several threads; those to the application's process one by one."""

    def __init__(self, feeds: StartFeeds) -> None:
        self._feeds = feeds
        self._listed = ListedMachines()
        self._asking, self._acting = threading.Lock(), threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._reading = ""
        self._command: tuple[str, ...] = ()
        self._begun: Begun | None = None
        self._result: Path | None = None
        self._run: Path | None = None
        self._run_feeds: RunFeeds | None = None
        self._words = ""

    @property
    def watched(self) -> Path | None:
        """The run that is watched."""
        return self._run

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """What `StartFeeds.worker` answers; BadInput for what it is not asked here, and its own."""
        kinds = [kind for kind in ASKED if kind in request]
        if len(kinds) != 1:
            raise BadInput(f"a request asks one of {', '.join(ASKED)}, not {', '.join(map(str, request)) or 'nothing'}.")
        kind = kinds[0]
        question = {kind: request[kind]}
        if kind == "machines":
            question["path"] = str(self._listed.tried)
        if kind == "forecast" and isinstance(request[kind], dict) and request[kind].get("is_listed"):
            question = {kind: {**request[kind], "system": str(self._listed.tried)}}
        with self._asking:
            answer = self._answer(question)
        if "error" in answer:
            raise BadInput(str(answer["error"]))
        return answer

    def folder(self, path: str) -> dict[str, Any]:
        """Names of the folders and files in a folder of this machine, hidden ones left out;
        BadInput where it cannot be read."""
        folder = Path(path or ".")
        try:
            folder = folder.expanduser().resolve()
            folder = folder if folder.is_dir() else folder.parent
            entries = sorted((entry for entry in folder.iterdir() if not entry.name.startswith(".")), key=lambda entry: entry.name.lower())
            folders = [entry.name for entry in entries if entry.is_dir()]
        except (OSError, RuntimeError) as error:  # RuntimeError: ~ of somebody who is not there
            raise BadInput(f"{folder} cannot be read: {getattr(error, 'strerror', None) or error}: choose another folder.") from error
        files = [entry.name for entry in entries if entry.name not in set(folders)]
        parent = "" if folder.parent == folder else str(folder.parent)
        more = max(0, len(folders) - MAX_NAMES) + max(0, len(files) - MAX_NAMES)
        return {"path": str(folder), "parent": parent, "folders": folders[:MAX_NAMES], "files": files[:MAX_NAMES], "more": more}

    def keep(self, choice: Mapping[str, Any]) -> None:
        """Write listed machines where the command line of a choice names them."""
        if not choice.get("is_listed"):
            return
        name = choice.get("system_as")
        if not isinstance(name, str) or not name.strip():
            raise BadInput("the list of machines has no file to be kept in: give it a name such as machines.toml.")
        try:
            self._listed.keep(Path(name))
        except OSError as error:
            raise BadInput(f"the list of machines cannot be written to {name}: {error.strerror or error}.") from error

    def begin(self, choice: Mapping[str, Any]) -> None:
        """Begin the command of a choice; BadInput where it has none, or another is at work."""
        with self._acting:
            self._require_idle()
            command = tuple(self.ask({"forecast": choice})["command"])
            self.keep(choice)
            self._result = result_path(command[0], Path(str(choice["out"])))
            self._command, self._words, self._run_feeds = command, "", None
            self._run = self._result if command[0] == "run" else None
            self._begun = self._feeds.begin(command)

    def watch(self, path: str) -> None:
        """Show the stages of a run that is there; BadInput where it is none, or another is at
        work."""
        with self._acting:
            self._require_idle()
            if not (Path(path) / "manifest.json").is_file():
                raise BadInput(f"{path} is no run, it has no manifest.json: choose the folder of a run.")
            self._run = self._result = Path(path)
            self._command, self._words, self._run_feeds, self._begun = (), "", None, None

    def stop(self) -> None:
        """End what is watched as Ctrl-C does; BadInput where nothing is at work."""
        with self._acting:
            if self._begun is not None and self._begun.poll() is None:
                self._begun.stop()
                return
            self._control().stop()

    def resume(self) -> None:
        """Go on with the run that is watched; BadInput where that cannot be."""
        with self._acting:
            self._require_idle()
            control = self._control()
            self._command, self._words = control.arguments(), ""
            self._begun = control.resume()

    def state(self) -> dict[str, Any]:
        """What is at work, of what there is a result, and how far the run is."""
        words = "" if self._begun is None else self._begun.poll()
        is_at_work = words is None
        self._words = words or self._words
        state: dict[str, Any] = {
            "reading": self._reading,
            "line": f"radiant {join(self._command)}" if self._command else "",
            "at_work": is_at_work,
            "words": self._words,
            "result": str(self._result) if self._result is not None and self._result.exists() else "",
            "run": "" if self._run is None else str(self._run),
            "has_plan": self._run is not None and is_planned(self._run),
        }
        return state | self._progress()

    def end(self) -> None:
        """End the application's process; a run that was begun goes on."""
        self._listed.end()
        if self._process is not None:
            with suppress(OSError):
                assert self._process.stdin is not None
                self._process.stdin.close()
            self._process.terminate()
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _progress(self) -> dict[str, Any]:
        if self._run is None or not (self._run / "manifest.json").is_file():
            return {"progress": None}
        if self._run_feeds is None:
            self._run_feeds = self._feeds.feeds(self._run)
        try:
            now = self._run_feeds.progress()
        except RadiantError as error:
            # The run may be in the middle of writing.
            return {"progress": None, "summary": str(error)}
        return {"progress": {**asdict(now), "shares": [stage.share for stage in now.stages]}, "summary": progress_summary(now)}

    def _require_idle(self) -> None:
        if self._begun is not None and self._begun.poll() is None:
            raise BadInput("another command that was begun here is at work: stop it, or wait for its end.")

    def _control(self) -> Any:
        if self._run is not None and (self._run / "manifest.json").is_file():
            feeds = self._run_feeds = self._run_feeds or self._feeds.feeds(self._run)
            if feeds.control is not None:
                return feeds.control
        raise BadInput("no run is watched here: choose the folder of one, or begin one.")

    def _answer(self, question: Mapping[str, Any]) -> dict[str, Any]:
        if self._process is None or self._process.poll() is not None:
            self._start_process()
        assert self._process is not None and self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(question).encode() + b"\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except OSError:
            answer = b""
        if not answer:
            self._process.wait()
            raise BadInput(f"what answers ended ({self._reading or 'no message'}): try it again.")
        self._reading = ""
        return json.loads(answer)

    def _start_process(self) -> None:
        pipe = subprocess.PIPE
        # A session of its own: Ctrl-C is for the page.
        process = self._process = subprocess.Popen(self._feeds.worker, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True)
        assert process.stderr is not None
        threading.Thread(target=self._read_words, args=(process.stderr,), daemon=True).start()

    def _read_words(self, stream: Any) -> None:
        for line in stream:
            self._reading = line.decode(errors="replace").strip()
