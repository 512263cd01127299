/* A Modbus server of Debian's libmodbus: libmodbus_server tcp PORT | rtu DEVICE. The same data as pymodbus_server.py,
 * one unit. */
#include <errno.h>
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

int main(int argc, char **argv)
{
    if (argc < 3)
        return 2;
    int tcp = strcmp(argv[1], "tcp") == 0;
    modbus_t *bus = tcp ? modbus_new_tcp("127.0.0.1", atoi(argv[2])) : modbus_new_rtu(argv[2], 19200, 'N', 8, 1);
    modbus_mapping_t *map = modbus_mapping_new(200, 200, 200, 200);
    int listening = -1;
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];

    if (!bus || !map)
        return 1;
    for (int i = 0; i < 4; i++)
        map->tab_registers[i] = map->tab_input_registers[i] = 301 + i;
    for (int i = 0; i < 200; i++)
        map->tab_input_bits[i] = i % 2;
    modbus_set_slave(bus, 1);
    if (tcp) {
        listening = modbus_tcp_listen(bus, 1);
        puts("ready");
        fflush(stdout);
        if (modbus_tcp_accept(bus, &listening) < 0)
            return 1;
    } else {
        if (modbus_connect(bus) < 0)
            return 1;
        puts("ready");
        fflush(stdout);
    }
    for (;;) {
        int length = modbus_receive(bus, query);
        if (length > 0) {
            modbus_reply(bus, query, length, map);
        } else if (length < 0 && tcp) {
            modbus_close(bus);
            if (modbus_tcp_accept(bus, &listening) < 0)
                return 1;
        }
    }
}
