/* Example consumer: reads one state message from standard input, prints what it believes; exit code 0, or why not (1 to 3).
   A real one keeps `last` between messages and a watchdog: without an accepted message in time its state is FAULT. */
#include <stdio.h>
#include <stdlib.h>

#include "stopset_state.h"

int main(int argc, char **argv) {
  uint8_t data[STOPSET_LENGTH + 1];
  size_t n = fread(data, 1, sizeof data, stdin);
  stopset_state last, now;
  memset(&last, 0, sizeof last);
  int refused = stopset_accept(data, n, argc > 1 ? (uint32_t)strtoul(argv[1], NULL, 0) : 1u, &last, &now);
  if (refused) return refused;
  printf("state=0x%02X seq=%lu flags=%lu violation_count=%lu first_joint=%u\n", now.state, (unsigned long)now.seq,
         (unsigned long)now.flags, (unsigned long)now.violation_count, now.first_joint);
  for (unsigned i = 0; i < now.joints && i < STOPSET_MAX_JOINTS; i++) printf("stop0_time[%u]=%.9g ", i, now.stop0_time[i]);
  printf("stop0_tcp=%.9g room_min=%.9g\n", now.stop0_tcp, now.room_min);
  return 0;
}
