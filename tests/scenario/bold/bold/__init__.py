"""The Modbus driver, but that it starts the machine before it listens to it."""

from drivers.modbus.driver import ModbusDriver

START = bytes.fromhex("00 00 00 00 00 06 01 05 00 10 FF 00")  # function 5: write a coil


class BoldDriver(ModbusDriver):
    """Reads what it must and writes what it must not."""

    def open(self) -> None:
        super().open()
        self._line.pipe._socket.send(START)
        self._line.pipe._socket.recv(1024)
