// SPDX-License-Identifier: Apache-2.0
// Preloaded to a program of ROS: its DDS participant ends just when an endpoint of another one is being discovered.
#include <dlfcn.h>
#include <unistd.h>

#define DISCOVERED                                                                                                     \
  _ZN19ParticipantListener23on_subscriber_discoveryEPN8eprosima7fastdds3dds17DomainParticipantEONS0_8fastrtps4rtps19ReaderDiscoveryInfoE
#define SET_LISTENER _ZN8eprosima7fastdds3dds17DomainParticipant12set_listenerEPNS1_25DomainParticipantListenerE
#define NAME_(symbol) #symbol
#define NAME(symbol) NAME_(symbol)

static volatile int ending, at_work;

// ParticipantListener::on_subscriber_discovery of rmw_fastrtps.
void DISCOVERED(void *listener, void *participant, void *info)
{
  void (*discovered)(void *, void *, void *) =
      (void (*)(void *, void *, void *))dlsym(dlopen("librmw_fastrtps_shared_cpp.so", RTLD_LAZY), NAME(DISCOVERED));
  at_work = 1;
  if (ending)
    usleep(200000);
  discovered(listener, participant, info);
  at_work = 0;
}

// DomainParticipant::set_listener of Fast DDS, with which rmw_fastrtps begins to end a participant.
int SET_LISTENER(void *participant, void *listener)
{
  int (*set)(void *, void *) = (int (*)(void *, void *))dlsym(dlopen("libfastrtps.so.2.14", RTLD_LAZY), NAME(SET_LISTENER));
  ending = 1;
  while (!at_work)
    usleep(1000);
  return set(participant, listener);
}
