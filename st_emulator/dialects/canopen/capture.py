"""The state CAPTURE: images one behind the other, and what is kept of the last one."""

from __future__ import annotations

from functools import partial

from ...clock import NS_PER_MS, NS_PER_S
from ...device.commands import CaptureImage, Failure, RefusedError
from ...device.image_memory import CapturedImage
from ...device.star_tracker import StarTracker
from ...firmware_model.image.frame import Frame
from ...protocol.canopen import card
from ...protocol.canopen.dictionary import Dictionary
from .card_time import unix_us_at
from .images import display_image, load_encoder, passes, raw_image

US_PER_S = 1_000_000
MOST_SECONDS = 0xFFFF_FFFF_FFFF_FFFF


class Capture:
    """Captures until there are enough or the duration is over; the objects 4001h and 4003h.

    It gives the device one command at a time, and is told how that goes.
    """

    def __init__(self, device: StarTracker, dictionary: Dictionary) -> None:
        self._device = device
        self._dictionary = dictionary
        self.active = False
        self._run = 0  # counts captures; what was scheduled for an earlier one is void
        self._last: Frame | None = None
        load_encoder()
        dictionary.on_read(card.CAPTURE, card.LAST_CAPTURE, self._raw)
        dictionary.on_read(card.CAPTURE, card.LAST_DISPLAY_IMAGE, self._display)

    def reset(self) -> None:
        """As after a start: no image."""
        self.stop()
        self._last = None

    def _setting(self, sub: int) -> int:
        return self._dictionary.number(card.CAPTURE, sub)

    def begin(self) -> None:
        """The card enters CAPTURE."""
        self._run += 1
        self.active = True
        self._dictionary[card.CAPTURE, card.IMAGES_CAPTURED] = 0
        # ASSUMED: at its end also while an image or the delay is waited for.
        duration_ns = self._setting(card.DURATION) * NS_PER_S
        self._device.later(duration_ns, partial(self._over, self._run))
        if duration_ns:
            self._next(self._run)

    def stop(self) -> None:
        """The card leaves CAPTURE; an image that is still awaited is not taken."""
        self.active = False

    def _over(self, run: int) -> None:
        if run == self._run:
            self.stop()

    def _next(self, run: int) -> None:
        """The next image, if there is to be one."""
        if not self.active or run != self._run:
            return
        wanted = self._setting(card.NUMBER_OF_IMAGES)
        if wanted and self._setting(card.IMAGES_CAPTURED) >= wanted:
            self.stop()
            return
        if self._device.image_memory.busy:  # an image of an earlier CAPTURE is on its way: it will do
            return
        command = CaptureImage()
        try:
            self._device.check(command)
        except RefusedError:
            self.stop()
            return
        self._device.execute(command, self)

    def captured(self, image: CapturedImage) -> None:
        """The device has an image."""
        if not self.active:
            return
        delay_ns = 0
        if self._wanted(image.pixels):
            self.keep(image.pixels, image.mid_exposure_ns)
            count = self._setting(card.IMAGES_CAPTURED) + 1
            self._dictionary[card.CAPTURE, card.IMAGES_CAPTURED] = count
            delay_ns = self._setting(card.DELAY) * NS_PER_MS
        self._device.later(delay_ns, partial(self._next, self._run))

    def _wanted(self, frame: Frame) -> bool:
        number = self._dictionary.number
        subs = (card.LOWER_BOUND, card.LOWER_PERCENTAGE, card.UPPER_BOUND, card.UPPER_PERCENTAGE)
        bounds = [number(card.CAPTURE_FILTER, sub) for sub in subs]
        return not number(card.CAPTURE_FILTER, card.FILTER_ENABLE) or passes(frame, *bounds)

    def keep(self, frame: Frame, mid_exposure_ns: int) -> None:
        """This is the last image now."""
        self._last = frame
        unix_s = unix_us_at(self._device, mid_exposure_ns) // US_PER_S
        self._dictionary[card.CAPTURE, card.LAST_CAPTURE_TIME] = unix_s & MOST_SECONDS

    def _raw(self) -> bytes:
        return b"" if self._last is None else raw_image(self._last)

    def _display(self) -> bytes:
        return b"" if self._last is None else display_image(self._last)

    # -- how the device's command goes

    def started(self) -> None:
        pass

    def progressed(self, step: int) -> None:
        pass

    def completed(self) -> None:
        pass

    def failed(self, failure: Failure, data: int = 0) -> None:
        self.stop()
