/* A tension frame has up to five channels. Bits are numbered from the lowest bit of byte 0 (Intel order):
 *
 *     bits    0..3       4..15       16..27      28..39      40..51      52..63
 *     field   counter    channel 0   channel 1   channel 2   channel 3   channel 4
 *
 * A channel holds the tension above -6 N, in steps of 62.5 mN. The codes 0 and 4095 mean that the reading is
 * not valid. The counter repeats the low four bits of the byte in SYNC. A frame with fewer channels is shorter.
 */
#include "node.h"

#include <string.h>

enum { PER_FRAME = 5, CHANNEL_BITS = 12, COUNTER_BITS = 4, BROKEN = 0, LAST_CODE = 4095 };

static const int32_t COUNTS_MAX = (1 << 23) - 1;   /* counts at an end of the ADC's range mean a broken bridge */
static const int64_t STEP_NN = 62500000;           /* tension of one code step [nN]: 62.5 mN */
static const int64_t LOWEST_NN = -6000000000;      /* tension of code 0 [nN]: -6 N */

bool node_init(struct node *node, const struct node_settings *settings, const struct node_board *board) {
    const int frames = (settings->channels + PER_FRAME - 1) / PER_FRAME;
    if (settings->channels < 1 || settings->channels > NODE_CHANNELS) return false;
    if (settings->sync_id > 0x7FF || settings->base_id + frames - 1 > 0x7FF) return false;
    /* No tension frame of this node may have the identifier of SYNC. */
    if (settings->sync_id >= settings->base_id && settings->sync_id < settings->base_id + frames) return false;
    for (uint8_t i = 0; i < settings->channels; i++) {
        if (settings->nN_per_count[i] == 0) return false;
    }
    memset(node, 0, sizeof *node);
    node->settings = *settings;
    node->board = *board;
    return true;
}

/* Return the 12-bit code of a reading, and count the SYNCs without a new conversion. */
static uint16_t code_of(struct node *node, int channel, const struct node_reading *reading) {
    const struct node_settings *settings = &node->settings;
    if (reading->valid && reading->fresh) node->stale[channel] = 0;
    else if (node->stale[channel] < NODE_STALE_SYNCS) node->stale[channel]++;
    if (!reading->valid || node->stale[channel] >= NODE_STALE_SYNCS) return BROKEN;
    if (reading->counts >= COUNTS_MAX || reading->counts <= -COUNTS_MAX) return BROKEN;
    /* The product fits in 64 bits: at most 2^24 counts times 2^31 nN. */
    const int64_t counts = (int64_t)reading->counts - settings->zero[channel];
    const int64_t above = counts * settings->nN_per_count[channel] - LOWEST_NN + STEP_NN / 2;
    if (above < STEP_NN) return BROKEN;
    return above / STEP_NN >= LAST_CODE ? LAST_CODE : (uint16_t)(above / STEP_NN);
}

void node_receive(struct node *node, uint16_t id, const uint8_t *data, uint8_t length) {
    struct node_reading readings[NODE_CHANNELS];
    const struct node_settings *settings = &node->settings;
    if (id != settings->sync_id) return;
    if (length != 1) {
        node->malformed++;
        return;
    }
    memset(readings, 0, sizeof readings);
    node->board.read(node->board.context, readings, settings->channels);
    for (int first = 0; first < settings->channels; first += PER_FRAME) {
        const int left = settings->channels - first;
        const int count = left < PER_FRAME ? left : PER_FRAME;
        const int size = (COUNTER_BITS + CHANNEL_BITS * count + 7) / 8;
        uint64_t word = data[0] & 0xF;
        uint8_t payload[8];
        for (int i = 0; i < count; i++) {
            const uint64_t code = code_of(node, first + i, &readings[first + i]);
            word |= code << (COUNTER_BITS + CHANNEL_BITS * i);
        }
        for (int i = 0; i < size; i++) payload[i] = (uint8_t)(word >> (8 * i));
        const uint16_t answer_id = (uint16_t)(settings->base_id + first / PER_FRAME);
        node->board.send(node->board.context, answer_id, payload, (uint8_t)size);
    }
}
