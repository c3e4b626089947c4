#include "server/haptics/safety_chain.hpp"
