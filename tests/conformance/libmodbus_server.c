/* An independent Modbus device: libmodbus serves input and holding registers whose value is their address times three. */
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

int main(int argc, char **argv) {
    int rtu = argc > 2 && strcmp(argv[1], "rtu") == 0;
    if (argc < 3) return 2;
    modbus_t *context = rtu ? modbus_new_rtu(argv[2], 115200, 'N', 8, 1) : modbus_new_tcp("127.0.0.1", atoi(argv[2]));
    modbus_mapping_t *map = modbus_mapping_new(0, 0, 2000, 2000);
    for (int i = 0; i < 2000; i++) map->tab_registers[i] = map->tab_input_registers[i] = 3 * i;
    map->tab_input_registers[0] = 0;
    map->tab_input_registers[1] = 100;
    if (rtu) modbus_set_slave(context, 1);
    int listener = rtu ? modbus_connect(context) : modbus_tcp_listen(context, 1);
    if (listener < 0) return 1;
    puts("ready");
    fflush(stdout);
    for (;;) {
        uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
        if (!rtu && modbus_tcp_accept(context, &listener) < 0) return 1;
        int size;
        while ((size = modbus_receive(context, query)) >= 0)
            if (size > 0) modbus_reply(context, query, size, map);
        if (rtu) return 0;
    }
}
