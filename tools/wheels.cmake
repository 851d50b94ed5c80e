# Changes for building interfaces with ROS from wheels: passed as CMAKE_PROJECT_INCLUDE. They build
# what Python loads and no C++ interface; the others are applied once everything is configured.

# Introspection stays: by it the middleware registers each type.
find_package(rosidl_default_generators REQUIRED)
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp")

# Remove include paths that exist only on the machine that built the wheels.
function(humanopts_drop_missing_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(includes ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(includes)
      set(kept "")
      foreach(path IN LISTS includes)
        if(path MATCHES "^\\$<" OR EXISTS "${path}")
          list(APPEND kept "${path}")
        endif()
      endforeach()
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
    endif()
  endforeach()
endfunction()

function(humanopts_generate_interfaces)
  set(script "${CMAKE_CURRENT_FUNCTION_LIST_DIR}/generate_interfaces.py")
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS "${script}")
  execute_process(
    COMMAND "${Python3_EXECUTABLE}" "${script}" "${CMAKE_CURRENT_BINARY_DIR}"
    COMMAND_ERROR_IS_FATAL ANY)
endfunction()

# Compile the sources of many messages as one: most of the time goes into the same headers.
# Descriptions stay separate: they have the same static names in each file.
function(humanopts_join_sources)
  get_property(targets DIRECTORY PROPERTY BUILDSYSTEM_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(type ${target} TYPE)
    if(type MATCHES "LIBRARY$" AND NOT type STREQUAL "INTERFACE_LIBRARY")
      set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 24)
      get_target_property(sources ${target} SOURCES)
      list(FILTER sources INCLUDE REGEX "__description\\.c$")
      set_source_files_properties(${sources} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    endif()
  endforeach()
endfunction()

cmake_language(DEFER CALL humanopts_drop_missing_includes)
cmake_language(DEFER CALL humanopts_join_sources)
cmake_language(DEFER CALL humanopts_generate_interfaces)
