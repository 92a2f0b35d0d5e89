/* Load-cell node of handctl. At each SYNC frame, it samples the load cells and answers with tension frames.
 *
 * src/handctl/drives/sensors/sensor_node.dbc defines the frames. The code is portable C11 and allocates no
 * memory. A board supplies two functions: one reads the ADCs, the other sends a CAN frame.
 */
#ifndef LOAD_CELL_NODE_H
#define LOAD_CELL_NODE_H

#include <stdbool.h>
#include <stdint.h>

enum {
    NODE_CHANNELS = 15,       /* largest number of load cells: three frames of five */
    NODE_STALE_SYNCS = 3,     /* a load cell counts as broken after so many SYNCs without a new conversion */
};

/* Settings of a node. They are constant after power-up. */
struct node_settings {
    uint16_t sync_id;                        /* 11-bit identifier of SYNC: sensor_node.sync_id of the hand file */
    uint16_t base_id;                        /* identifier of the first tension frame: sensor_node.base_id */
    uint8_t channels;                        /* number of load cells (1 to NODE_CHANNELS), ordered as sensor_node.tendons */
    int32_t zero[NODE_CHANNELS];             /* ADC counts of each load cell without load */
    int32_t nN_per_count[NODE_CHANNELS];     /* tension per ADC count [nN], negative for a cell mounted in reverse */
};

/* One reading of a load cell. */
struct node_reading {
    int32_t counts;   /* ADC counts: 24-bit two's complement, sign extended */
    bool valid;       /* the ADC has answered, with the right checksum and settings */
    bool fresh;       /* a conversion has ended since the last reading */
};

/* The board: the two functions that depend on its hardware, and their first argument. */
struct node_board {
    void (*read)(void *context, struct node_reading *readings, uint8_t channels);
    void (*send)(void *context, uint16_t id, const uint8_t *data, uint8_t length);
    void *context;
};

struct node {
    struct node_settings settings;
    struct node_board board;
    uint8_t stale[NODE_CHANNELS];   /* SYNCs since the last new conversion of each load cell */
    uint32_t malformed;             /* number of SYNC frames with a wrong length */
};

/* Check the settings and initialize a node. Returns false if the settings are not valid. */
bool node_init(struct node *node, const struct node_settings *settings, const struct node_board *board);

/* Process a received CAN frame. The node answers SYNC at once, and ignores every other frame. */
void node_receive(struct node *node, uint16_t id, const uint8_t *data, uint8_t length);

#endif
