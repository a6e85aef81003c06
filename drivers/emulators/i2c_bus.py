"""An emulated I2C bus in this process: chip models by address, and faults on demand."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Lock

from drivers.emulators.chips.base import ChipModel


@dataclass(frozen=True)
class Message:
    """One message of a transaction: ``data`` is what is written, ``count`` what is read."""

    address: int
    data: bytes = b""
    count: int | None = None


Fault = Callable[[int, tuple[Message, ...]], int | None]
"""Given the transaction's number (from 1) and its messages, the errno to fail it with, or None."""


def fail_at(number: int, code: int = errno.EIO, *, stays: bool = False) -> Fault:
    """Return a fault at one transaction, or (`stays`) at it and all after it."""

    def fault(n: int, messages: tuple[Message, ...]) -> int | None:
        return code if n == number or (stays and n > number) else None

    return fault


class EmulatedBus:
    """Chip models on one bus. It is a `drivers.chips.base.Bus`, and what the FUSE rig serves.

    Each transaction is whole before the next begins, whatever thread it comes from.
    """

    def __init__(self, models: Mapping[int, ChipModel], *, fault: Fault | None = None) -> None:
        self.models = dict(models)
        self.fault = fault
        self.transactions = 0
        self._lock = Lock()

    def transfer(self, *messages: Message) -> list[bytes]:
        """Carry out one transaction and return what each of its messages read."""
        with self._lock:
            self.transactions += 1
            code = self.fault(self.transactions, messages) if self.fault else None
            if code is not None:
                raise OSError(code, os.strerror(code))
            out = []
            for message in messages:
                model = self.models.get(message.address)
                if model is None:  # nobody pulls the line down: no acknowledge
                    raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
                if message.count is None:
                    model.write(message.data)
                    out.append(b"")
                else:
                    out.append(model.read(message.count))
            return out

    def read(self, address: int, register: int, count: int) -> bytes:
        """Read registers after a repeated start."""
        write = Message(address, bytes([register]))
        return self.transfer(write, Message(address, count=count))[1]

    def write(self, address: int, register: int, data: bytes) -> None:
        """Write registers."""
        self.transfer(Message(address, bytes([register]) + data))

    def close(self) -> None:
        """Do nothing: the models stay."""
