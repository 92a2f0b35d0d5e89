/* Load-cell node of handctl: samples on SYNC and answers with tension frames.
 *
 * Frames are those of src/handctl/drives/sensors/sensor_node.dbc. The code is portable C11 without
 * allocation. A board supplies two functions: read the ADCs, send a CAN frame.
 */
#ifndef LOAD_CELL_NODE_H
#define LOAD_CELL_NODE_H

#include <stdbool.h>
#include <stdint.h>

enum {
    NODE_CHANNELS = 15,       /* largest number of load cells: three frames of five */
    NODE_STALE_SYNCS = 3,     /* SYNCs without a new conversion after which a cell counts as broken */
};

/* Settings of a node, constant after power-up. */
struct node_settings {
    uint16_t sync_id;                        /* 11-bit identifier of SYNC, sensor_node.sync_id */
    uint16_t base_id;                        /* identifier of the first tension frame, sensor_node.base_id */
    uint8_t channels;                        /* load cells, 1 to NODE_CHANNELS, in the order of sensor_node.tendons */
    int32_t zero[NODE_CHANNELS];             /* counts of the unloaded cells */
    int32_t nN_per_count[NODE_CHANNELS];     /* tension of a count [nN], negative for a cell mounted in reverse */
};

/* One reading of a load cell. */
struct node_reading {
    int32_t counts;   /* 24-bit two's complement, sign extended */
    bool valid;       /* the ADC answered, and its checksum and settings are right */
    bool fresh;       /* a conversion ended since the last reading */
};

/* Board: the two functions that depend on the hardware. */
struct node_board {
    void (*read)(void *context, struct node_reading *readings, uint8_t channels);
    void (*send)(void *context, uint16_t id, const uint8_t *data, uint8_t length);
    void *context;
};

struct node {
    struct node_settings settings;
    struct node_board board;
    uint8_t stale[NODE_CHANNELS];   /* SYNCs since the last new conversion */
    uint32_t malformed;             /* SYNCs with a wrong length */
};

/* Check settings and initialize a node. Returns false if the settings cannot be used. */
bool node_init(struct node *node, const struct node_settings *settings, const struct node_board *board);

/* Take a received CAN frame. SYNC is answered at once, and every other frame is ignored. */
void node_receive(struct node *node, uint16_t id, const uint8_t *data, uint8_t length);

#endif
