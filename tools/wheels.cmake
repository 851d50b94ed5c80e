# What building interfaces with ROS from wheels needs. It is passed as CMAKE_PROJECT_INCLUDE and
# done once everything is configured.

# The wheels export include paths of the machine that built them. Those that do not exist go.
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

cmake_language(DEFER CALL humanopts_drop_missing_includes)
cmake_language(DEFER CALL humanopts_generate_interfaces)
