import pytest

from calib.errors import AddressError
from drivers.address import parse_address
from drivers.transports import make_driver


@pytest.mark.parametrize(
    ("text", "scheme", "target", "options"),
    [
        (
            "serial:///dev/ttyUSB0?dialect=witmotion&baud=115200",
            "serial",
            "/dev/ttyUSB0",
            {"dialect": "witmotion", "baud": "115200"},
        ),
        ("serial://COM3", "serial", "COM3", {}),
        ("i2c://1/0x68?chip=mpu6050", "i2c", "1/0x68", {"chip": "mpu6050"}),
        (
            "replay://my%20logs/a%3Fb.arrow?speed=0.5",
            "replay",
            "my logs/a?b.arrow",
            {"speed": "0.5"},
        ),
        ("replay:///abs/log.csv", "replay", "/abs/log.csv", {}),
        ("emulator://witmotion?", "emulator", "witmotion", {}),
    ],
)
def test_takes_apart(text: str, scheme: str, target: str, options: dict[str, str]) -> None:
    address = parse_address(text)
    assert (address.scheme, address.target, dict(address.options)) == (scheme, target, options)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("/dev/ttyUSB0", "serial:///dev/ttyUSB0"),
        ("com3", "serial://com3"),
        ("log.arrow", "replay://log.arrow"),
        ("hello", "i2c://1/0x68"),
        ("serial://", "nothing stands after"),
        ("serial:///dev/x?baud", "option=value"),
        ("serial:///dev/x?baud=1&baud=2", "stands twice"),
    ],
)
def test_refuses_and_says_what_to_write(text: str, says: str) -> None:
    with pytest.raises(AddressError, match=says.replace("?", r"\?")):
        parse_address(text)


def test_unknown_option_names_the_known_ones() -> None:
    address = parse_address("serial:///dev/x?boud=9600")
    with pytest.raises(AddressError, match=r"did you mean baud.*baud, dialect"):
        address.check({"baud", "dialect"})


def test_numbers_are_checked() -> None:
    address = parse_address("i2c://1/0x68?rate=fast&n=0x10&low=-1")
    assert address.integer("n", 1) == 16
    assert address.number("absent", 2.5) == 2.5
    with pytest.raises(AddressError, match="rate=fast is not a number"):
        address.number("rate", 1.0)
    with pytest.raises(AddressError, match="not a whole number"):
        address.integer("rate", 1)
    with pytest.raises(AddressError, match="at least 0"):
        address.number("low", 1.0)


def test_unknown_scheme() -> None:
    with pytest.raises(AddressError, match="unknown scheme usb"):
        make_driver("usb://1")
