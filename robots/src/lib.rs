//! Arms behind the hal traits: URDF kinematics, simulator, Viper S650 driver and emulator.
