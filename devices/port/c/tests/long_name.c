/* Describes and opens the first port, whose name is as long as a name can be. */
#include "takt_port.h"

#include <string.h>

int main(int count, char **arguments) {
    takt_ports *ports = NULL;
    takt_port *port = NULL;
    takt_port_description description;

    if (count != 2 || takt_ports_open(arguments[1], &ports) != TAKT_PORT_NO_ERROR)
        return 1;
    if (takt_ports_describe(ports, 0, &description) != TAKT_PORT_NO_ERROR)
        return 2;
    if (strcmp(description.name, "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa") != 0 || description.maximum != 512 ||
        description.refresh_ns != 1000000000)
        return 3;
    if (takt_port_open(ports, description.name, 0, &port) != TAKT_PORT_NO_ERROR)
        return 4;
    takt_port_close(port);
    takt_ports_close(ports);
    return 0;
}
