#include <utility>

#include "daemon/config_key_makers.h"

namespace omnihdr {
namespace {

using namespace config_key_makers;  // NOLINT(google-build-using-namespace)

constexpr std::size_t kNameBytes = 64;  // of a chip or a line; the kernel's own limit is 31
constexpr std::size_t kPathBytes = 4096;

using Adder = std::vector<ConfigKey>&;

void AddNumber(Adder keys, const std::string& section, ConfigKey table, Member<int> address,
               Member<modbus::NumberType> type, Member<modbus::WordOrder> order,
               Member<double> scale, Member<double> offset) {
  keys.push_back(std::move(table));
  keys.push_back(Whole(section + ".register", "a register's address", -1, 65535, address));
  keys.push_back(Choice(
      section + ".type",
      std::vector{modbus::NumberType::kU16, modbus::NumberType::kI16, modbus::NumberType::kU32,
                  modbus::NumberType::kI32, modbus::NumberType::kF32},
      type));
  keys.push_back(Choice(section + ".word_order",
                        std::vector{modbus::WordOrder::kHighFirst, modbus::WordOrder::kLowFirst},
                        order));
  keys.push_back(Number(section + ".scale", "a number", -1e9, 1e9, scale));
  keys.push_back(Number(section + ".offset", "a number", -1e12, 1e12, offset));
}

}  // namespace

// The keys of one number in [modbus.client.NAME]; its member in VehicleOptions has that name.
#define OMNIHDR_ADD_NUMBER(NAME)                                                                 \
  AddNumber(                                                                                     \
      keys, "modbus.client." #NAME,                                                              \
      Choice("modbus.client." #NAME ".table", tables, OMNIHDR_MEMBER(modbus.client.NAME.table)), \
      OMNIHDR_MEMBER(modbus.client.NAME.address), OMNIHDR_MEMBER(modbus.client.NAME.type),       \
      OMNIHDR_MEMBER(modbus.client.NAME.word_order), OMNIHDR_MEMBER(modbus.client.NAME.scale),   \
      OMNIHDR_MEMBER(modbus.client.NAME.offset))

void AddVehicleKeys(std::vector<ConfigKey>& keys) {
  const auto add = [&keys](ConfigKey key) { keys.push_back(std::move(key)); };
  const std::vector edges{gpio::Edge::kRising, gpio::Edge::kFalling, gpio::Edge::kBoth};
  const std::vector biases{gpio::Bias::kAsIs, gpio::Bias::kDisabled, gpio::Bias::kPullUp,
                           gpio::Bias::kPullDown};

  add(Text("gpio.trigger.chip", "a chip's label or name", kNameBytes,
           OMNIHDR_MEMBER(gpio.inputs.trigger.name.chip)));
  add(Text("gpio.trigger.line", "a line's name or offset", kNameBytes,
           OMNIHDR_MEMBER(gpio.inputs.trigger.name.line)));
  add(Choice("gpio.trigger.edge", edges, OMNIHDR_MEMBER(gpio.inputs.trigger.edge)));
  add(Choice("gpio.trigger.bias", biases, OMNIHDR_MEMBER(gpio.inputs.trigger.bias)));
  add(Number("gpio.trigger.debounce_s", "seconds", 0, 1,
             OMNIHDR_MEMBER(gpio.inputs.trigger.debounce_s)));

  add(Text("gpio.wheel.chip", "a chip's label or name", kNameBytes,
           OMNIHDR_MEMBER(gpio.inputs.wheel.name.chip)));
  add(Text("gpio.wheel.line", "a line's name or offset", kNameBytes,
           OMNIHDR_MEMBER(gpio.inputs.wheel.name.line)));
  add(Choice("gpio.wheel.edge", edges, OMNIHDR_MEMBER(gpio.inputs.wheel.edge)));
  add(Choice("gpio.wheel.bias", biases, OMNIHDR_MEMBER(gpio.inputs.wheel.bias)));
  add(Number("gpio.wheel.debounce_s", "seconds", 0, 1,
             OMNIHDR_MEMBER(gpio.inputs.wheel.debounce_s)));
  add(Number("gpio.wheel.pulses_per_metre", "pulses", 0.01, 1e6,
             OMNIHDR_MEMBER(gpio.inputs.pulses_per_metre)));

  add(Text("gpio.outputs.chip", "a chip's label or name", kNameBytes,
           OMNIHDR_MEMBER(gpio.outputs.chip)));
  add(Text("gpio.outputs.ready", "a line's name or offset", kNameBytes,
           OMNIHDR_MEMBER(gpio.outputs.ready)));
  add(Text("gpio.outputs.busy", "a line's name or offset", kNameBytes,
           OMNIHDR_MEMBER(gpio.outputs.busy)));
  add(Text("gpio.outputs.fault", "a line's name or offset", kNameBytes,
           OMNIHDR_MEMBER(gpio.outputs.fault)));
  add(Text("gpio.outputs.strobe", "a line's name or offset", kNameBytes,
           OMNIHDR_MEMBER(gpio.outputs.strobe)));
  add(Switch("gpio.outputs.active_low", OMNIHDR_MEMBER(gpio.outputs.active_low)));
  add(Number("gpio.outputs.strobe_s", "seconds", 1e-5, 1, OMNIHDR_MEMBER(gpio.outputs.strobe_s)));
  add(Text("gpio.outputs.camera_trigger", "a line's name or offset", kNameBytes,
           OMNIHDR_MEMBER(gpio.camera_trigger.name.line)));
  add(Switch("gpio.outputs.camera_trigger_active_low",
             OMNIHDR_MEMBER(gpio.camera_trigger.active_low)));
  add(Number("gpio.outputs.camera_trigger_s", "seconds", 1e-5, 1,
             OMNIHDR_MEMBER(gpio.camera_trigger.pulse_s)));
  add(Number("gpio.outputs.camera_trigger_spacing_s", "seconds", 1e-5, 10,
             OMNIHDR_MEMBER(gpio.camera_trigger.spacing_s)));

  const std::vector connections{modbus::Connection::kOff, modbus::Connection::kTcp,
                                modbus::Connection::kRtu};
  const std::vector parities{modbus::Parity::kNone, modbus::Parity::kEven, modbus::Parity::kOdd};
  const std::vector tables{modbus::Table::kHolding, modbus::Table::kInput};

  add(Choice("modbus.client.connection", connections,
             OMNIHDR_MEMBER(modbus.client.endpoint.connection)));
  add(Address("modbus.client.address", OMNIHDR_MEMBER(modbus.client.endpoint.address)));
  add(Whole("modbus.client.port", "a port", 1, 65535, OMNIHDR_MEMBER(modbus.client.endpoint.port)));
  add(Path("modbus.client.device", "a serial device", Empty::kRefused, kPathBytes,
           OMNIHDR_MEMBER(modbus.client.endpoint.device)));
  add(Whole("modbus.client.baud", "bits per second", 1200, 230400,
            OMNIHDR_MEMBER(modbus.client.endpoint.baud)));
  add(Choice("modbus.client.parity", parities, OMNIHDR_MEMBER(modbus.client.endpoint.parity)));
  add(Whole("modbus.client.unit", "a whole number", 0, 255,
            OMNIHDR_MEMBER(modbus.client.endpoint.unit)));
  add(Number("modbus.client.poll_s", "seconds", 0.005, 60, OMNIHDR_MEMBER(modbus.client.poll_s)));
  add(Number("modbus.client.timeout_s", "seconds", 0.01, 10,
             OMNIHDR_MEMBER(modbus.client.timeout_s)));
  add(Number("modbus.client.stale_s", "seconds", 0.05, 3600,
             OMNIHDR_MEMBER(modbus.client.stale_s)));
  add(Number("modbus.client.reconnect_s", "seconds", 0.1, 3600,
             OMNIHDR_MEMBER(modbus.client.reconnect_s)));
  add(Number("modbus.client.max_speed_m_s", "metres per second", 0.1, 1000,
             OMNIHDR_MEMBER(modbus.client.max_speed_m_s)));
  OMNIHDR_ADD_NUMBER(odometer);
  add(Number("modbus.client.odometer.wrap", "counts", 0, 1e15,
             OMNIHDR_MEMBER(modbus.client.odometer_wrap)));
  OMNIHDR_ADD_NUMBER(speed);
  OMNIHDR_ADD_NUMBER(heading);
  add(Choice("modbus.client.heartbeat.table", tables,
             OMNIHDR_MEMBER(modbus.client.heartbeat.table)));
  add(Whole("modbus.client.heartbeat.register", "a register's address", -1, 65535,
            OMNIHDR_MEMBER(modbus.client.heartbeat.address)));

  add(Choice("modbus.server.connection", connections,
             OMNIHDR_MEMBER(modbus.server.endpoint.connection)));
  add(Address("modbus.server.address", OMNIHDR_MEMBER(modbus.server.endpoint.address)));
  add(Whole("modbus.server.port", "a port", 1, 65535, OMNIHDR_MEMBER(modbus.server.endpoint.port)));
  add(Path("modbus.server.device", "a serial device", Empty::kRefused, kPathBytes,
           OMNIHDR_MEMBER(modbus.server.endpoint.device)));
  add(Whole("modbus.server.baud", "bits per second", 1200, 230400,
            OMNIHDR_MEMBER(modbus.server.endpoint.baud)));
  add(Choice("modbus.server.parity", parities, OMNIHDR_MEMBER(modbus.server.endpoint.parity)));
  add(Whole("modbus.server.unit", "a whole number", 1, 247,
            OMNIHDR_MEMBER(modbus.server.endpoint.unit)));
  add(Switch("modbus.server.control", OMNIHDR_MEMBER(modbus.control)));

  add(Switch("gnss.enabled", OMNIHDR_MEMBER(gnss.enabled)));
  add(Address("gnss.address", OMNIHDR_MEMBER(gnss.gpsd.address)));
  add(Whole("gnss.port", "a port", 1, 65535, OMNIHDR_MEMBER(gnss.gpsd.port)));
  add(Number("gnss.max_age_s", "seconds", 0.1, 60, OMNIHDR_MEMBER(gnss.gpsd.max_age_s)));
  add(Switch("gnss.track_heading", OMNIHDR_MEMBER(gnss.gpsd.track_heading)));
}

}  // namespace omnihdr
