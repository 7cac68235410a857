# SPDX-License-Identifier: Apache-2.0
"""A bag to be read: opened once, whole, cut off or damaged, in one file or several."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_bags.bag_files import find_files, open_bag_file
from abrace_bags.metadata import METADATA_FILE
from abrace_bags.raw import RawMessages
from abrace_bags.reader import read_arrays, sequence_ranges
from abrace_bags.run import RESPONSE_TYPE, runs_of
from abrace_bags.topics import RecordedTopic, Selection, every_of, is_end_of
from abrace_core import AbraceError
from abrace_core.files.suggestion import expected_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from abrace_bags.mcap.attachments import StoredAttachment
    from abrace_bags.mcap.bag_file import BagFile
    from abrace_bags.reader import TopicArrays
    from abrace_bags.sequence import NumberRanges
    from abrace_core.model.run import Run


COPY_RECORD = "abrace_copy"
"""Name of the metadata record of a bag that was made of others: the `warnings` of these, one a line."""


class Bag:
    """A bag to be read. One file that can't be read does not keep the others from being read.

    Topics can be named by the end of their name, `response` for `/demo/response`, where only one topic has that end.
    Times are log times [ns]; a part of a bag has its `begin`, and not its `end`; None: from the first message, to the
    last.

    Parameters
    ----------
    path
        A bag directory, or a single MCAP or sqlite3 file.

    Attributes
    ----------
    path
        As given.
    files
        Those that can be read, in their order.

    Raises
    ------
    AbraceError
        If there is no such bag, or none of its files can be read.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.files: list[BagFile] = []
        self._warnings: dict[str, None] = {}
        self._disorder: set[str] = set()
        try:
            exists = self.path.exists()
        except OSError as error:
            raise AbraceError(f"{path}: {error.strerror}") from error
        if not exists:
            raise AbraceError(f"{path}: no such bag, expected a bag directory or an MCAP file")
        paths, problems, self._counted = find_files(self.path)
        unreadable = []
        for one in paths:
            try:
                self.files.append(open_bag_file(one))
            except AbraceError as error:
                unreadable.append(str(error))
        if not self.files:
            raise AbraceError("; ".join(unreadable))
        self._unreadable = bool(unreadable)
        self._warn([*problems, *(f"{reason}; nothing is read of it" for reason in unreadable)])

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is missing or can't be trusted, as far as the bag was read until now; one sentence each."""
        self._warn(())
        return tuple(self._warnings)

    @property
    def damage(self) -> tuple[str, ...]:
        """The `warnings` without those of log times alone, which cost no message."""
        return tuple(warning for warning in self.warnings if warning not in self._disorder)

    @cached_property
    def topics(self) -> dict[str, RecordedTopic]:
        """By name."""
        everything = Selection()
        for file in self.files:
            file.know()
            for channel in file.channels.values():
                everything.accepts(channel)
        others = {name: topic for name, (topic, _) in everything.left_out.items()}
        return dict(sorted((others | everything.topics).items()))

    @cached_property
    def facts(self) -> dict[str, str]:
        """The run's facts (rig, controller, record, versions), of the first file that has them; empty without."""
        for file in self.files:
            file.know()
            if file.facts is not None:
                return file.facts
        return {}

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records: texts by key, by the record's name."""
        for file in self.files:
            file.know()
        return {name: texts for file in self.files for name, texts in file.metadata.items()}

    @property
    def attachments(self) -> list[StoredAttachment]:
        """Files of the run."""
        for file in self.files:
            file.know()
        return [attachment for file in self.files for attachment in file.attachments]

    @property
    def uncounted(self) -> bool:
        """Whether messages may be missing and the files do not say how many."""
        return self._unreadable or any(file.uncounted for file in self.files)

    def raw(self, topics: Collection[str] = (), begin: int | None = None, end: int | None = None) -> RawMessages:
        """Find serialised messages, which are then read chunk by chunk, as often as they are asked for.

        Parameters
        ----------
        topics
            Their names; all when empty. Messages of other types than their topic's first are left out with a warning.
        begin, end
            Log times [ns].

        Raises
        ------
        AbraceError
            If a name is not in the bag, or matches several topics, or all messages of one asked for are left out.
        """
        selection = Selection(topics, begin, end)
        found = RawMessages(self.files, selection, self.facts)
        self._check(selection)
        self._compare(selection, {name: one.messages for name, one in found.contents.items()})
        warnings = list(self.warnings)
        if found.set_back:
            warnings.append(
                f"{self.path}: the clock was set back during the recording: messages come in the order of the file"
            )
        else:
            warnings += [
                f"{self.path}: the times of {name} step back, its messages come in the order of their times"
                for name, one in found.contents.items()
                if one.steps_back
            ]
        found.warnings = tuple(warnings)
        return found

    def arrays(
        self, topics: Collection[str] = (), begin: int | None = None, end: int | None = None
    ) -> dict[str, TopicArrays]:
        """Read messages as arrays; of files with an index, only chunks that may hold requested messages.

        Parameters
        ----------
        topics
            Their names; all when empty. Topics that can't be decoded are left out with a warning.
        begin, end
            Log times [ns].

        Returns
        -------
        dict
            By the topics' whole names.

        Raises
        ------
        AbraceError
            If a name is not in the bag, or matches several topics, or one asked for can't be decoded.
        """
        selection = Selection(topics, begin, end)
        try:
            found, failed, missing, disorder = read_arrays(self.files, selection)
        except MemoryError as error:
            raise AbraceError(f"{self.path}: more than there is memory, expected a part of it") from error
        of_order = [f"{self.path}: topic {note}" for note in disorder]
        self._disorder.update(of_order)
        self._warn([*(f"{self.path}: topic {note}" for note in missing), *of_order])
        self._check(selection)
        if not missing:
            self._compare(selection, {name: one.log_time.size for name, one in found.items()})
        for name, why in failed.items():
            if topics:
                raise AbraceError(f"{self.path}: topic {name} can't be read: {why}")
            self._warn([f"{self.path}: topic {name} is left out: {why}"])
        if self.uncounted:
            self._warn(
                f"{self.path}: {missing_messages(name, sequence_ranges(one, every_of(self.facts, name)))}"
                for name, one in found.items()
            )
        return found

    def run(self, topic: str | None = None) -> Run:
        """The recorded test of the rig, of which no sample may be missing.

        Parameters
        ----------
        topic
            The topic of the responses; when None, the only one of their type.

        Returns
        -------
        Run
            Its facts are those of the bag; its `warnings`, if there are any, are among them, and `every` where of so
            many samples one was recorded: it then has the numbers and the period of these alone.

        Raises
        ------
        AbraceError
            If there is no such topic, it has no messages, lacks samples, has several runs, or a value is not finite.
        """
        parts = self._runs(topic)
        runs = [run for part in parts for run in part]
        if len(runs) > 1:
            every = runs[0].facts.get("every", 1)
            before, after = every * int(runs[0].sequence[-1]), every * int(runs[1].sequence[0])
            why = f"sample {before} is followed by sample {after}, expected {before + every}"
            if len(parts[0]) == 1:
                why = f"sample {before} is followed by sample {after} of another run (the rig was activated again)"
            raise AbraceError(f"{self.path}: {why}{in_brackets(self.warnings)}")
        return runs[0]

    def runs(self, topic: str | None = None) -> list[Run]:
        """The recorded tests of the rig, each without a gap, in the order in which they were recorded.

        A new one begins where the rig was activated again, and behind missing samples. `topic` and what is raised are
        as for `run`; each run has the numbers of its samples, and says in its facts, as `warnings`, what is missing.
        """
        return [run for part in self._runs(topic) for run in part]

    def tests(self, topic: str | None = None) -> list[Run]:
        """As `runs` of a `topic`, but of what was recorded each time the rig was activated the longest run alone."""
        return [max(part, key=lambda run: run.sequence.size) for part in self._runs(topic)]

    def _runs(self, topic: str | None) -> list[list[Run]]:
        named = [name for name, one in self.topics.items() if one.type_name == RESPONSE_TYPE]
        if topic is not None:
            named = [name for name in named if name == topic or is_end_of(topic, name)]
        if len(named) > 1:
            raise AbraceError(f"{self.path}: has {len(named)} topics of responses, name one of {', '.join(named)}")
        if not named:
            asked = f"no topic {topic}" if topic else "no topic"
            raise AbraceError(f"{self.path}: {asked} of type {RESPONSE_TYPE} in it{in_brackets(self.warnings)}")
        response = self.arrays(named)[named[0]]
        try:
            return runs_of(str(self.path), response, self.facts, self.warnings, every_of(self.facts, named[0]))
        except AbraceError as error:
            raise AbraceError(f"{self.path}: topic {named[0]}: {error}{in_brackets(self.warnings)}") from error

    def time_range(
        self, start_offset: float, duration: float, topics: Collection[str] = ()
    ) -> tuple[int | None, int | None]:
        """Begin and end [ns] of a part of the bag.

        Parameters
        ----------
        start_offset
            Seconds from the first message of the topics.
        duration
            Seconds from there; 0: to the end.
        topics
            Their names; all when empty.

        Raises
        ------
        AbraceError
            If there are messages, but none that late, or a name is not in the bag.
        """
        if not start_offset and not duration:
            return None, None
        selection = Selection(self.choose(topics) if topics else ())
        edges = [
            time
            for last in (False, True)
            for file in self.files
            for messages in file.ends(selection, last)
            for time in messages.log_time.tolist()
        ]
        if not edges:
            return None, None
        first, last_time = min(edges), max(edges)
        begin = first + round(start_offset * 1e9)
        if begin > last_time:
            part = f"{start_offset:g} s to {f'{start_offset + duration:g} s' if duration else 'the end'}"
            span = 1e-9 * (last_time - first)
            raise AbraceError(f"{self.path}: there is no message from {part}, its messages span {span:.3f} s")
        return begin, begin + round(duration * 1e9) if duration else None

    def choose(self, asked: Collection[str], names: Iterable[str] | None = None) -> list[str]:
        """Whole names of the topics `asked` for, among `names`: those of the bag when None.

        Raises
        ------
        AbraceError
            If one is not in the bag, or matches several topics.
        """
        known = sorted(self.topics if names is None else set(names))
        chosen = []
        for one in asked:
            matching = [one] if one in known else [name for name in known if is_end_of(one, name)]
            if len(matching) > 1:
                raise AbraceError(f"{self.path}: topic {one} matches {', '.join(matching)}, name one of them")
            if not matching:
                where = f"{self.path}: no topic {one} in it{in_brackets(self.warnings)}"
                raise AbraceError(f"{where}, {expected_of(one, known)}")
            chosen += matching
        return chosen

    def _check(self, selection: Selection) -> None:
        """Warn of messages that are left out; a topic that was asked for of which that are all is an error."""
        self.choose(selection.asked, (channel.name for file in self.files for channel in file.channels.values()))
        for name, (_, why) in selection.left_out.items():
            if selection.asked and name not in selection.topics:
                raise AbraceError(f"{self.path}: messages of topic {name} can't be read: {why}")
            self._warn([f"{self.path}: messages of topic {name} are left out: {why}"])

    def _compare(self, selection: Selection, found: Mapping[str, int]) -> None:
        """Warn of topics that have fewer messages than metadata.yaml counts, if nothing else says what is missing."""
        if selection.begin is None and selection.end is None:
            known = "; ".join(self.warnings)
            self._warn(
                f"{self.path}: {METADATA_FILE} counts {self._counted[name]} messages of {name}, {count} are there"
                for name, count in found.items()
                if self._counted.get(name, 0) > count and f" messages of {name} are missing" not in known
            )

    def _warn(self, texts: Iterable[str]) -> None:
        """Add what the files say, and further `texts`."""
        for file in self.files:
            self._warnings.update(dict.fromkeys(file.warnings))
            for warning in file.metadata.get(COPY_RECORD, {}).get("warnings", "").splitlines():
                self._warnings[f"{self.path}: was made of another bag: {warning}"] = None
        self._warnings.update(dict.fromkeys(texts))


def read_run(bag: Path | str, topic: str | None = None) -> Run:
    """The recorded test of the rig in a `bag`, as `Bag.run` gives it."""
    return Bag(bag).run(topic)


def read_runs(bag: Path | str, topic: str | None = None) -> list[Run]:
    """The recorded tests of the rig in a `bag`, as `Bag.runs` gives them."""
    return Bag(bag).runs(topic)


def in_brackets(warnings: Sequence[str]) -> str:
    """The `warnings` of a bag for the error that they may explain; empty without any."""
    return f" ({'; '.join(warnings)})" if warnings else ""


def missing_messages(topic: str, numbers: NumberRanges | None) -> str:
    """How many messages of a `topic` are missing by their `numbers`, for a warning where the bag's count is lost."""
    if numbers is None or not numbers.ranges:
        return f"topic {topic}: the number of missing messages is unknown"
    span = f"{numbers.ranges[0][0]} to {numbers.ranges[-1][1]}"
    return f"topic {topic}: {numbers.missing} of the samples {span} are missing, later ones are not known"
